"""Keys on disk: issued, copied to another computer, revoked; who may send what; and what is refused."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import time

import msgspec
import pytest

from agents.shell.bus_security import BusSecurity
from agents.team.participant import Role
from agents.team.verbs import VERBS
from gcs.errors import Exit, InputError
from gcs.keys.authority_folder import AuthorityFolder
from gcs.keys.certificates import DAY_S, name_and_expiry
from gcs.keys.key_folder import KeyFolder
from gcs.keys.roster import ROSTER_FILE
from tests.conftest import Ran, RunHere
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S


@pytest.fixture
def keys(tmp_path: Path) -> AuthorityFolder:
    """Return a folder with keys of a vehicle, two operators, a sensor and an observer."""
    folder = AuthorityFolder(tmp_path / "keys")
    folder.init(10.0)
    folder.issue("vehicle", "3", 1.0)
    folder.issue("operator", "anna", 1.0)
    folder.issue("operator", "bob", 1.0, ("hold", "kill"))
    folder.issue("sensor", "mast", 1.0)
    folder.issue("positions", "cameras", 1.0)
    folder.issue("observer", "tower", 1.0)
    return folder


def security_of(keys: AuthorityFolder, role: Role, name: str) -> BusSecurity:
    security = KeyFolder(keys.path).identity(role, name).security
    assert security is not None
    return security


def granted(keys: AuthorityFolder, common_name: str) -> set[str]:
    """Return the keys that a vehicle hears from a certificate."""
    grants = security_of(keys, "vehicle", "3").grants
    return {key for grant in grants if grant.common_name == common_name for key in (*grant.topics, *grant.presence)}


def test_each_role_may_send_on_its_own_keys_only(keys: AuthorityFolder) -> None:
    own = {"member/3", "start/3", "answer/3", "@report/3", "head/3", "roster/3", "alive/3"}
    assert granted(keys, "vehicle-3") == own
    steering = set(VERBS) - {"kill"}
    assert granted(keys, "operator-anna") == {f"command/{verb}/anna" for verb in steering} | {
        "roster/anna",
        "operator/anna",
    }
    assert granted(keys, "operator-bob") == {"command/hold/bob", "command/kill/bob", "roster/bob", "operator/bob"}
    assert granted(keys, "sensor-mast") == {"perception/mast"}
    assert granted(keys, "positions-cameras") == {"position/cameras"}
    assert granted(keys, "observer-tower") == set()


def test_a_router_passes_on_all_that_anybody_may_send(keys: AuthorityFolder) -> None:
    keys.issue("router", "hill", 1.0)
    passes_on = [key.split("/") for key in granted(keys, "router-hill")]

    def passed(key: str) -> bool:
        parts = key.split("/")
        return any(len(parts) == len(each) and all(map(_alike, each, parts)) for each in passes_on)

    for holder in ("vehicle-3", "operator-anna", "operator-bob", "sensor-mast", "positions-cameras"):
        assert all(map(passed, granted(keys, holder))), holder
    assert not passed("target/3")


def _alike(pattern: str, part: str) -> bool:
    return pattern in ("*", part)


def test_what_is_not_allowed_is_denied_and_nobody_may_write_patterns(keys: AuthorityFolder) -> None:
    settings = replace(security_of(keys, "vehicle", "3"), sockets=None).settings("team")
    assert settings["transport/link/protocols"] == ["tls"]
    control = settings["access_control"]
    assert isinstance(control, dict)
    assert control["default_permission"] == "deny"
    for rule in control["rules"]:
        if "ingress" in rule["flows"] and set(rule["messages"]) & {"put", "delete", "liveliness_token"}:
            assert not any("*" in key or "$" in key for key in rule["key_exprs"]), rule
    everybody = {
        "vehicle-3",
        "operator-anna",
        "operator-bob",
        "sensor-mast",
        "positions-cameras",
        "observer-tower",
    }
    assert {name for subject in control["subjects"] for name in subject["cert_common_names"]} == everybody


def test_only_the_user_may_read_them(keys: AuthorityFolder, subtests: pytest.Subtests) -> None:
    for path in [keys.path, *keys.path.rglob("*")]:
        with subtests.test(path=path.relative_to(keys.path.parent)):
            assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600)
    key = keys.path / "vehicle-3" / "private-key.pem"
    key.chmod(0o640)
    with pytest.raises(InputError, match="chmod 600"):
        security_of(keys, "vehicle", "3")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a file to another user")
def test_a_private_key_of_another_user_is_refused(keys: AuthorityFolder) -> None:
    os.chown(keys.path / "vehicle-3" / "private-key.pem", 12345, 12345)
    with pytest.raises(InputError, match=r"private-key\.pem: it belongs to another user \(user id 12345\)"):
        security_of(keys, "vehicle", "3")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize("name", ["private-key.pem", "certificate.pem", "authority.pem"])
def test_what_is_no_file_is_not_read(keys: AuthorityFolder, name: str, kind: str) -> None:
    path = keys.path / "vehicle-3" / name
    path.unlink()
    match kind:
        case "pipe":
            os.mkfifo(path, 0o600)
        case "device":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir(0o700)
    with pytest.raises(InputError, match=f"{name}: it is not a file"):
        security_of(keys, "vehicle", "3")


def test_a_folder_copied_to_another_computer_is_complete(keys: AuthorityFolder, tmp_path: Path) -> None:
    there = tmp_path / "drone" / "keys"
    shutil.copytree(keys.path / "vehicle-3", there / "vehicle-3")
    security = KeyFolder(there).identity("vehicle", "3").security
    assert security == security_of(keys, "vehicle", "3")
    assert security is not None
    assert b"PRIVATE" in security.private_key_pem
    assert "PRIVATE" not in repr(security)
    assert not list(there.rglob("authority"))


def test_revoked_keys_are_granted_nothing_and_issued_again_have_another_name(keys: AuthorityFolder) -> None:
    before = security_of(keys, "operator", "bob").certificate_pem
    keys.revoke("operator-bob")
    assert granted(keys, "operator-bob") == set()
    with pytest.raises(InputError, match="revoked"):
        security_of(keys, "operator", "bob")
    keys.issue("operator", "bob", 1.0, ("hold",))
    after = security_of(keys, "operator", "bob")
    assert after.certificate_pem != before
    assert granted(keys, "operator-bob") == set(), "the certificate that was revoked still counts"
    assert granted(keys, "operator-bob~2") == {"command/hold/bob", "roster/bob", "operator/bob"}


def test_renewed_keys_are_accepted_beside_those_that_they_replace(keys: AuthorityFolder, tmp_path: Path) -> None:
    there = KeyFolder(tmp_path / "drone" / "keys")
    shutil.copytree(keys.path / "vehicle-3", there.path / "vehicle-3")
    before, grants = security_of(keys, "vehicle", "3"), security_of(keys, "operator", "bob").grants
    renewed = {each.label: each for each in keys.renew(None, 9.0)}
    assert renewed.keys() == {each.label for each in keys.roster.valid}
    after = security_of(keys, "vehicle", "3")
    assert after.certificate_pem != before.certificate_pem
    assert set(security_of(keys, "operator", "bob").grants) == set(grants)
    assert name_and_expiry(after.certificate_pem)[0] == name_and_expiry(before.certificate_pem)[0]
    shutil.copyfile(keys.path / ROSTER_FILE, there.path / "vehicle-3" / ROSTER_FILE)
    here, copied = (
        {each.label: each.expires_s for each in folder.holders()} for folder in (KeyFolder(keys.path), there)
    )
    assert copied["vehicle-3"] < time() + DAY_S < here["vehicle-3"], "its own certificate counts, not the roster"
    keys.revoke("operator-bob")
    with pytest.raises(InputError, match="operator-bob"):
        keys.renew("operator-bob", 9.0)


def test_a_certificate_that_the_roster_does_not_admit_is_refused(keys: AuthorityFolder, tmp_path: Path) -> None:
    there = KeyFolder(tmp_path / "drone" / "keys")
    shutil.copytree(keys.path / "vehicle-3", there.path / "vehicle-3")
    keys.issue("vehicle", "3", 1.0)
    shutil.copyfile(keys.path / ROSTER_FILE, there.path / "vehicle-3" / ROSTER_FILE)
    with pytest.raises(InputError, match=r"certificate\.pem: it is the certificate vehicle-3; .* vehicle-3~2"):
        there.identity("vehicle", "3")


def test_keys_that_are_issued_at_the_same_time_are_all_on_the_roster(keys: AuthorityFolder) -> None:
    command = [sys.executable, "-m", "gcs", "keys", "issue", "observer", "--keys", str(keys.path)]
    names = [f"at-once-{i}" for i in range(6)]
    issuing = [subprocess.Popen([*command, name], cwd=ROOT, stderr=subprocess.DEVNULL) for name in names]
    assert [each.wait(PATIENCE_S) for each in issuing] == [Exit.HOLDS] * len(names)
    roster = keys.roster
    assert {each.name for each in roster.holders} >= set(names)
    for name in names:
        assert KeyFolder(keys.path).identity("observer", name).participant.name == name


def test_keys_that_expire_soon_are_warned_of(
    keys: AuthorityFolder, run_here: RunHere, subtests: pytest.Subtests
) -> None:
    keys.renew("operator-anna", 9.0)
    keys.revoke("operator-bob")
    code, out, err = run_here("keys", "show", "--keys", str(keys.path))
    assert code == Exit.HOLDS
    warned = " ".join(err.split())
    for label, soon in {"vehicle-3": True, "operator-anna": False, "operator-bob": False}.items():
        with subtests.test(holder=label):
            assert (f"cordon keys renew {label}" in warned) == soon
    assert "(9 days)" in next(line for line in out.splitlines() if line.startswith("operator-anna"))


def test_an_encrypted_authority_issues_nothing_without_its_passphrase(
    keys: AuthorityFolder, tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ran(*command: str, **environment: str) -> Ran:
        with monkeypatch.context() as patched:
            for name, value in environment.items():
                patched.setenv(f"CORDON_KEYS_{name}", value)
            return run_here("keys", *command, "--keys", str(keys.path))

    assert ran("passphrase", NEW_PASSPHRASE="").code == Exit.BAD_INPUT
    assert ran("passphrase", NEW_PASSPHRASE="first").code == Exit.HOLDS
    private_key = keys.path / "authority" / "private-key.pem"
    assert b"ENCRYPTED" in private_key.read_bytes()
    assert stat.S_IMODE(private_key.stat().st_mode) == 0o600
    unasked = ran("issue", "vehicle", "4")
    assert unasked.code == Exit.BAD_INPUT
    assert "CORDON_KEYS_PASSPHRASE" in unasked.err
    wrong = ran("revoke", "operator-bob", PASSPHRASE="last")
    assert (wrong.code, "the passphrase is wrong" in wrong.err) == (Exit.BAD_INPUT, True)
    assert not any(each.revoked for each in keys.roster.holders)
    assert ran("passphrase", PASSPHRASE="first", NEW_PASSPHRASE="second").code == Exit.HOLDS
    file = tmp_path / "passphrase"
    file.write_text("second\n")
    file.chmod(0o644)
    assert "chmod 600" in ran("issue", "vehicle", "4", PASSPHRASE_FILE=str(file)).err
    file.chmod(0o600)
    assert ran("issue", "vehicle", "4", PASSPHRASE_FILE=str(file)).code == Exit.HOLDS
    assert ran("show").code == Exit.HOLDS, "no secret is needed to look"
    assert KeyFolder(keys.path).identity("vehicle", "4").participant.name == "4"


def test_what_is_wrong_is_named_with_the_next_step(keys: AuthorityFolder, subtests: pytest.Subtests) -> None:
    folder = KeyFolder(keys.path)
    keys.issue("observer", "late", -1.0)
    stranger = AuthorityFolder(keys.path.parent / "others")
    stranger.init(1.0)
    stranger.issue("vehicle", "5", 1.0)
    shutil.copytree(stranger.path / "vehicle-5", keys.path / "vehicle-5")
    shutil.copyfile(keys.path / ROSTER_FILE, keys.path / "vehicle-5" / ROSTER_FILE)
    open_folder = keys.path / "sensor-mast"
    open_folder.chmod(0o755)
    asked: dict[str, Callable[[], object]] = {
        "cordon keys issue vehicle 4": lambda: folder.identity("vehicle", "4"),
        "operator-anna, operator-bob": lambda: folder.identity("operator"),
        "expired": lambda: folder.identity("observer", "late"),
        "another authority": lambda: folder.identity("vehicle", "5"),
        "chmod 700": lambda: folder.identity("sensor"),
        "there is no authority": lambda: AuthorityFolder(keys.path / "vehicle-3").issue("vehicle", "4", 1.0),
        "already": lambda: keys.init(1.0),
        "its id": lambda: keys.issue("vehicle", "03", 1.0),
        "letters": lambda: keys.issue("operator", "a/b", 1.0),
        "operator-carl": lambda: keys.revoke("operator-carl"),
    }
    for words, ask in asked.items():
        with subtests.test(words=words), pytest.raises(InputError, match=re.escape(words)):
            ask()


FIRST = "[[vehicles]]\nid = 1\n"
GRANTED_BY_HAND: Mapping[str, tuple[bytes, bytes]] = {
    "kill": (b'"hold",\n    "kill"', b'"hold",\n    "kill",\n    "land"'),
    "a later end": (b'"expires_s": ', b'"expires_s": 1'),
    "no revocation": (b'"revoked": true', b'"revoked": false'),
    "another serial": (b'"serial": ', b'"serial": 9'),
    "without its signature": (rb',\s*"signature": "[^"]*"', b""),
}


def test_what_was_edited_by_hand_grants_nothing(
    keys: AuthorityFolder, mission_file: Callable[..., str], run_here: RunHere, subtests: pytest.Subtests
) -> None:
    keys.revoke("sensor-mast")
    mission = mission_file("case2", (FIRST, f'[network]\nsecurity = {{ keys = "keys" }}\n\n{FIRST}'))
    places = [keys.path / ROSTER_FILE, keys.path / "operator-bob" / ROSTER_FILE]
    whole = places[0].read_bytes()
    for name, (before, after) in GRANTED_BY_HAND.items():
        edited = re.sub(before, after, whole, count=1)
        for place in places:
            place.write_bytes(edited)
        commands = ("command", "land", "--key", "bob", "--mission", mission), ("keys", "issue", "observer", "new")
        for command in commands:
            with subtests.test(name, command=command[0]):
                assert edited != whole
                options = ("--keys", str(keys.path)) if command[0] == "keys" else ()
                code, _, err = run_here(*command, *options)
                assert code == Exit.BAD_INPUT
                assert ROSTER_FILE in err.replace("\n", "")
                assert "next:" in err
        assert not (keys.path / "observer-new").exists()


def test_an_older_roster_is_refused_where_a_newer_one_was_used(keys: AuthorityFolder, tmp_path: Path) -> None:
    there = KeyFolder(tmp_path / "drone" / "keys")
    shutil.copytree(keys.path / "vehicle-3", there.path / "vehicle-3")
    file, newest = there.path / "vehicle-3" / ROSTER_FILE, keys.path / ROSTER_FILE
    older = file.read_bytes()
    keys.revoke("operator-bob")
    shutil.copyfile(newest, file)
    admitted = there.identity("vehicle", "3").security
    assert admitted is not None
    assert "operator-bob" not in {each.common_name for each in admitted.grants}
    file.write_bytes(older)
    with pytest.raises(InputError, match=r"roster\.json: it is an older roster .*; next: copy"):
        there.identity("vehicle", "3")
    newest.write_bytes(older)
    with pytest.raises(InputError, match="older roster"):
        keys.issue("observer", "new", 1.0)


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Make a folder read-only, as a container's mount does; to the superuser only a mount does that."""
    if os.geteuid():
        folder.chmod(0o500)
        yield
        folder.chmod(0o700)
        return
    try:
        subprocess.run(["mount", "--bind", folder, folder], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("mounts are not permitted here")
    try:
        subprocess.run(["mount", "-o", "remount,bind,ro", folder], check=True)
        yield
    finally:
        subprocess.run(["umount", folder], check=True)


def test_a_check_finds_keys_that_expire_within_the_mission_and_a_folder_that_keeps_no_newer_roster(
    keys: AuthorityFolder, mission_file: Callable[..., str], run_here: RunHere
) -> None:
    mission = mission_file("case2", (FIRST, f'[network]\nsecurity = {{ keys = "keys" }}\n\n{FIRST}'))
    keys.issue("vehicle", "1", 1.0)
    keys.issue("vehicle", "2", 0.5 / 24.0)
    folder = keys.path / "vehicle-1"
    with read_only(folder):
        assert KeyFolder(keys.path).identity("vehicle", "1").security is not None, "it can be used"
        code, out, _ = run_here("check", mission, "--json")
    assert code == Exit.REFUSED
    found = {
        (each["grade"], each["subject"], each["found"])
        for each in json.loads(out)["findings"]
        if each["check"] == "keys"
    }
    assert ("warning", "mission", f"{folder} cannot be written to") in found
    assert {about for grade, about, _ in found if grade == "refuse"} == {"vehicle 2"}


def test_a_roster_of_the_version_before_is_signed_by_who_has_the_authority(
    keys: AuthorityFolder, run_here: RunHere, subtests: pytest.Subtests
) -> None:
    keys.revoke("operator-bob")
    for place in keys.path.rglob(ROSTER_FILE):
        before = msgspec.json.decode(place.read_bytes())
        del before["serial"], before["signature"]
        place.write_bytes(msgspec.json.encode(before))
        place.with_name("roster-serial").unlink()
    with pytest.raises(InputError, match="next: `cordon keys sign`"):
        security_of(keys, "vehicle", "3")
    with subtests.test("no terminal"):
        assert run_here("keys", "sign", "--keys", str(keys.path)).code == Exit.BAD_INPUT
        with pytest.raises(InputError, match="not signed"):
            security_of(keys, "vehicle", "3")
    code, out, err = run_here("keys", "sign", "--keys", str(keys.path), "--yes")
    assert code == Exit.HOLDS
    assert "operator-bob" in out
    assert "next: copy" in err
    assert granted(keys, "operator-anna")
    assert granted(keys, "operator-bob") == set()
    assert run_here("keys", "sign", "--keys", str(keys.path)).code == Exit.HOLDS, "it is signed already"


def test_a_roster_that_was_tampered_with_is_refused(keys: AuthorityFolder, subtests: pytest.Subtests) -> None:
    file = keys.path / "vehicle-3" / ROSTER_FILE
    whole = file.read_bytes()
    damaged = {
        "cut off": whole[:-20],
        "an unknown verb": whole.replace(b'"kill"', b'"fly"'),
        "a pattern for a name": whole.replace(b'"bob"', b'"*"'),
        "an unknown role": whole.replace(b'"sensor"', b'"captain"'),
        "no JSON": b"\xff" * 100,
        "nested": b"[" * 100_000,
        "an end without a date": whole.replace(b'"expires_s": ', b'"expires_s": 99999999', 1),
    }
    for name, content in damaged.items():
        with subtests.test(name=name):
            assert content != whole
            file.write_bytes(content)
            with pytest.raises(InputError, match="roster"):
                security_of(keys, "vehicle", "3")


def test_the_commands_make_what_they_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_here: RunHere) -> None:
    monkeypatch.chdir(tmp_path)
    for line in (
        "init",
        "issue vehicle 3",
        "issue operator anna --may land,hold --days 2",
        "issue operator bob",
        "issue sensor mast",
        "revoke operator-bob",
    ):
        code, out, err = run_here("keys", *line.split())
        assert code == Exit.HOLDS, line
        assert "PRIVATE" not in out + err
    code, out, _ = run_here("keys", "show")
    shown = {line.split()[0]: line for line in out.splitlines()}
    assert code == Exit.HOLDS
    assert shown.keys() == {"operator-anna", "operator-bob", "sensor-mast", "vehicle-3"}
    assert "hold, land" in shown["operator-anna"]
    assert "revoked" in shown["operator-bob"]
    for line in ("issue operator carl --may fly", "init"):
        assert run_here("keys", *line.split()).code == Exit.BAD_INPUT
    assert [path.name for path in tmp_path.iterdir()] == ["keys"]
