"""Kill by approval: where the authority names approvers, neither it alone nor an approver alone grants it."""

import shutil
import ssl
from collections.abc import Callable, Mapping
from pathlib import Path
from time import time

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from agents.team.participant import Role
from gcs.errors import Exit, InputError
from gcs.keys.approval import APPROVAL_FILE, KILL_KEY_FILE, ApproverFolder, KillGrant
from gcs.keys.authority_folder import AuthorityFolder
from gcs.keys.certificates import CertificateAuthority, ContentKey, KeyPair
from gcs.keys.identity import Identity
from gcs.keys.key_folder import KeyFolder
from gcs.keys.roster import ROSTER_FILE, Roster, digest, write_roster
from tests.conftest import Ran, RunHere
from tests.gcs.keys.test_certificates import context, greeted
from tests.gcs.keys.test_key_folder import security_of

FIRST = "[[vehicles]]\nid = 1\n"


@pytest.fixture
def carol(tmp_path: Path) -> ApproverFolder:
    """Return an approver's folder, on another computer than the authority's."""
    folder = ApproverFolder(tmp_path / "carol" / "approver-carol", lambda: b"secret")
    folder.make()
    return folder


@pytest.fixture
def keys(tmp_path: Path, carol: ApproverFolder) -> AuthorityFolder:
    """Return keys of a team whose authority names the approver; bob waits for the approval of his kill."""
    folder = AuthorityFolder(tmp_path / "keys")
    folder.init(10.0, [carol.path / "public-key.pem"])
    folder.issue("vehicle", "3", 1.0)
    folder.issue("router", "hill", 1.0)
    folder.issue("operator", "anna", 1.0)
    folder.issue("operator", "bob", 1.0, ("hold", "kill"))
    return folder


def asked(keys: AuthorityFolder) -> KillGrant:
    return KillGrant.read(keys.path / "operator-bob" / "kill-request.json")


def approve(keys: AuthorityFolder, carol: ApproverFolder) -> Path:
    """Let the approver approve the kill of bob, who gets his kill key from her; return the approval."""
    folder = carol.approve(asked(keys))
    shutil.copyfile(folder / KILL_KEY_FILE, keys.path / "operator-bob" / KILL_KEY_FILE)
    (keys.path / "operator-bob" / KILL_KEY_FILE).chmod(0o600)
    return folder / APPROVAL_FILE


def granted(keys: AuthorityFolder, holder: tuple[Role, str] = ("vehicle", "3")) -> set[str]:
    """Return the keys on which a peer receives commands."""
    return {key for grant in security_of(keys, *holder).grants for key in grant.topics if key.startswith("command/")}


def bob(keys: AuthorityFolder) -> Identity:
    return KeyFolder(keys.path).identity("operator", "bob")


def authority_of(keys: AuthorityFolder) -> CertificateAuthority:
    """Return the authority, to issue and sign what no command does."""
    return CertificateAuthority(
        KeyPair(*((keys.path / "authority" / name).read_bytes() for name in ("certificate.pem", "private-key.pem")))
    )


def signed_alone(keys: AuthorityFolder, *approvals: KillGrant) -> None:
    """Let the authority sign a roster with any approvals of bob, as no command does."""
    holder = keys.roster.find("operator", "bob")
    assert holder is not None
    roster = keys.roster.put(msgspec.structs.replace(holder, approvals=approvals))
    KeyFolder(keys.path).put_roster(roster.signed(authority_of(keys).sign))


def test_the_authority_alone_grants_no_kill(
    keys: AuthorityFolder, mission_file: Callable[..., str], run_here: RunHere, subtests: pytest.Subtests
) -> None:
    peers: tuple[tuple[Role, str], ...] = ("vehicle", "3"), ("operator", "anna"), ("operator", "bob")
    for holder in peers:
        with subtests.test(holder=holder):
            assert "command/kill/bob" not in granted(keys, holder)
            assert "command/hold/bob" in granted(keys, holder)
    with subtests.test("the operator"):
        assert bob(keys).may == ("hold",)
    with subtests.test("what preflight reads"):
        assert not any("kill" in each.may for each in KeyFolder(keys.path).holders())
    for command in (("show",), ("renew", "operator-bob"), ("issue", "operator", "bob", "--may", "kill")):
        with subtests.test("the next step", command=command[0]):
            code, _, err = run_here("keys", *command, "--keys", str(keys.path))
            said = " ".join(err.split())
            assert code == Exit.HOLDS
            assert "operator-bob: its kill has to be approved; next: an approver runs `cordon keys approve" in said
    with subtests.test("sent nevertheless"):
        mission = mission_file("case2", (FIRST, f'[network]\nsecurity = {{ keys = "keys" }}\n\n{FIRST}'))
        code, _, err = run_here("command", "kill", "--yes", "--key", "bob", "--mission", mission)
        assert code == Exit.REFUSED
        assert "kill also needs an approved kill key" in " ".join(err.split())


def test_with_an_approval_kill_is_granted_until_it_expires_or_is_revoked(
    keys: AuthorityFolder, carol: ApproverFolder, subtests: pytest.Subtests
) -> None:
    approval = approve(keys, carol)
    assert bob(keys).may == ("hold",), "before it is in the roster"
    assert keys.admit(approval).name == "bob"
    assert bob(keys).may == ("hold", "kill")
    assert "command/kill/bob" in granted(keys)
    assert keys.awaiting == []
    with subtests.test("without the kill key"):
        kill_key = keys.path / "operator-bob" / KILL_KEY_FILE
        kill_key.rename(kill_key.with_suffix(".away"))
        assert bob(keys).may == ("hold",)
        kill_key.with_suffix(".away").rename(kill_key)
    with subtests.test("renewed"):
        keys.renew("operator-bob", 2.0)
        assert bob(keys).may == ("hold", "kill"), "the approval before lasts until its end"
        assert [holder.label for holder, _ in keys.awaiting] == ["operator-bob"]
        keys.admit(approve(keys, carol))
        assert bob(keys).may == ("hold", "kill")
        assert keys.awaiting == []
    with subtests.test("another operator"):
        keys.issue("operator", "dora", 1.0, ("kill",))
        assert "command/kill/dora" not in granted(keys)
    with subtests.test("issued again"):
        keys.issue("operator", "bob", 1.0, ("hold", "kill"))
        assert bob(keys).may == ("hold",)
        with pytest.raises(InputError, match="operator-bob of this authority is granted no kill"):
            keys.admit(approval)
    with subtests.test("revoked"):
        keys.admit(approve(keys, carol))
        assert "command/kill/bob" in granted(keys)
        keys.revoke("operator-bob")
        assert "command/kill/bob" not in granted(keys)


def test_an_approval_that_is_not_of_this_grant_counts_nowhere(
    keys: AuthorityFolder, carol: ApproverFolder, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    own = KillGrant.read(approve(keys, carol))
    mallory = ApproverFolder(tmp_path / "mallory" / "approver-mallory", lambda: b"secret")
    mallory.make()
    of_mallory = KillGrant.read(mallory.approve(asked(keys)) / APPROVAL_FILE)
    replace = msgspec.structs.replace

    def approved(**changes: object) -> KillGrant:
        return KillGrant.read(carol.approve(replace(asked(keys), **changes)) / APPROVAL_FILE)

    wrong: Mapping[str, tuple[KillGrant, str]] = {
        "a request": (asked(keys), "no approver has signed this request; next:"),
        "a later end": (replace(own, expires_s=own.expires_s + 1.0), "it was altered"),
        "another kill key": (replace(own, kill_key=ContentKey.made().public_key), "it was altered"),
        "no signature of it": (replace(own, signature=own.signature[:-1] + b"\0"), "it was altered"),
        "another approver": (of_mallory, "it was altered"),
        "in the approver's name": (replace(of_mallory, approver=own.approver), "it was altered"),
        "of a key that is none": (replace(own, approver=b"none"), "it was altered"),
        "another certificate": (approved(common_name="operator-bob~2"), "is granted no kill; next:"),
        "another operator": (approved(common_name="operator-anna"), "is granted no kill; next:"),
        "another authority": (approved(authority="0" * 64), "is granted no kill; next:"),
        "expired": (approved(expires_s=time() - 1.0), "it has expired; next: cordon keys approve"),
    }
    file = tmp_path / "approval.json"
    for name, (approval, fault) in wrong.items():
        with subtests.test(name, place="admit"):
            approval.write(file)
            with pytest.raises(InputError, match=fault):
                keys.admit(file)
        with subtests.test(name, place="signed by the authority"):
            signed_alone(keys, approval)
            assert "command/kill/bob" not in granted(keys)
            assert bob(keys).may == ("hold",)
    with subtests.test("the control"):
        signed_alone(keys, own)
        assert "command/kill/bob" in granted(keys)
        assert bob(keys).may == ("hold", "kill")


def test_what_is_no_request_is_refused(carol: ApproverFolder, tmp_path: Path, subtests: pytest.Subtests) -> None:
    whole = {"authority": "0" * 64, "common_name": "operator-bob", "expires_s": time() + 60.0}
    wrong: Mapping[str, Mapping[str, object]] = {
        "of a vehicle": {"common_name": "vehicle-3"},
        "a path": {"common_name": "operator-bob~/../../x"},
        "a path in the name": {"common_name": "operator-../x"},
        "control characters": {"authority": "\x1b[2J" + "0" * 60},
        "a date beyond all": {"expires_s": 1e300},
        "an unknown key": {"may": ["kill"]},
    }
    file = tmp_path / "request.json"
    for name, changes in wrong.items():
        with subtests.test(name=name):
            file.write_bytes(msgspec.json.encode({**whole, **changes}))
            with pytest.raises(InputError, match="neither a request nor an approval"):
                KillGrant.read(file)
    for content in (b"", b"[" * 100_000, b"\xff"):
        file.write_bytes(content)
        with pytest.raises(InputError, match="neither a request nor an approval"):
            KillGrant.read(file)


def certified_anew(keys: AuthorityFolder) -> CertificateAuthority:
    """Return the same authority without approvers, as who has its private key can make it."""
    private_key_pem = (keys.path / "authority" / "private-key.pem").read_bytes()
    private_key = serialization.load_pem_private_key(private_key_pem, None)
    assert isinstance(private_key, ec.EllipticCurvePrivateKey)
    other = x509.load_pem_x509_certificate(CertificateAuthority.made(10.0).keys.certificate_pem)
    builder = (
        x509.CertificateBuilder(other.issuer, other.subject, private_key.public_key(), other.serial_number)
        .not_valid_before(other.not_valid_before_utc)
        .not_valid_after(other.not_valid_after_utc)
    )
    for each in other.extensions:
        if not isinstance(each.value, x509.SubjectKeyIdentifier):
            builder = builder.add_extension(each.value, each.critical)
    pem = builder.sign(private_key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    return CertificateAuthority(KeyPair(pem, private_key_pem))


def test_the_authority_does_not_drop_its_approvers_unnoticed(
    keys: AuthorityFolder, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    named = authority_of(keys)
    forger, folder, later_s = certified_anew(keys), keys.path / "vehicle-3", time() + 60.0
    before, whole = folder / "authority.pem", (folder / "authority.pem").read_bytes()
    forged = Roster(digest(forger.keys.certificate_pem), 99, keys.roster.holders).signed(forger.sign)
    write_roster(folder / ROSTER_FILE, forged)
    with subtests.test("its roster"), pytest.raises(InputError, match="it is of another authority than the keys"):
        granted(keys)
    before.write_bytes(forger.keys.certificate_pem)
    assert "command/kill/bob" in granted(keys), "the control: who replaces the whole folder drops them"
    before.write_bytes(whole)
    for name, trusted in {"the same": named, "certified anew": forger}.items():
        server = context(ssl.PROTOCOL_TLS_SERVER, named.issue("vehicle-3", later_s), named, tmp_path)
        client = context(ssl.PROTOCOL_TLS_CLIENT, named.issue("operator-bob", later_s), trusted, tmp_path)
        with subtests.test("a link", trusted=name):
            if trusted is named:
                assert greeted(server, client) == ("operator-bob", "vehicle-3")
            else:
                with pytest.raises(ssl.SSLError):
                    greeted(server, client)


def test_only_the_approved_kill_key_signs_kills(
    keys: AuthorityFolder, carol: ApproverFolder, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    keys.admit(approve(keys, carol))
    operator, vehicle = bob(keys).security, KeyFolder(keys.path).identity("vehicle", "3").security
    assert operator is not None
    assert vehicle is not None
    assert "PRIVATE" not in repr(operator)
    key, payload = "command/kill/bob", b"\x93payload"
    signed = operator.signed("team", key, payload)
    assert vehicle.verified("team", key, signed) == payload
    hold = "command/hold/bob"
    assert vehicle.verified("team", hold, operator.signed("team", hold, payload)) == payload
    forged: Mapping[str, tuple[str, str, bytes]] = {
        "unsigned": ("team", key, payload),
        "altered": ("team", key, signed.replace(b"payload", b"pAyload")),
        "of another team": ("other", key, signed),
        "in another name": ("team", "command/kill/anna", signed),
        "by his other private key": (
            "team",
            key,
            msgspec.msgpack.encode(
                (payload, ContentKey(operator.private_key_pem).sign(b"team/command/kill/bob\0" + payload))
            ),
        ),
        "no pair": ("team", key, msgspec.msgpack.encode([b"", b"", b""])),
    }
    for name, (team, sent_on, content) in forged.items():
        with subtests.test(name=name):
            assert content != b""
            assert vehicle.verified(team, sent_on, content) is None
    with subtests.test("after the approval has expired"):
        monkeypatch.setattr("gcs.keys.approval.time", lambda: time() + 2 * 86400.0)
        assert vehicle.verified("team", key, signed) is None


def test_two_people_grant_kill_on_two_computers(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    office, home = tmp_path / "office", tmp_path / "home"

    def ran(folder: Path, *command: str, **environment: str) -> Ran:
        with monkeypatch.context() as patched:
            for name, value in environment.items():
                patched.setenv(f"CORDON_KEYS_{name}", value)
            return run_here("keys", *command, "--keys", str(folder))

    assert ran(home, "approver", "carol").code == Exit.BAD_INPUT, "no terminal"
    made = ran(home, "approver", "carol", NEW_PASSPHRASE="first")
    assert made.code == Exit.HOLDS
    assert b"ENCRYPTED" in (home / "approver-carol" / "private-key.pem").read_bytes()
    public = home / "approver-carol" / "public-key.pem"
    for wrong in ("private-key.pem", "missing.pem"):
        with subtests.test("init", approver=wrong):
            assert ran(office, "init", "--approver", str(public.with_name(wrong))).code == Exit.BAD_INPUT
            assert not office.exists()
    assert ran(office, "init", "--approver", str(public)).code == Exit.HOLDS
    assert ran(office, "issue", "operator", "bob", "--may", "hold,kill").code == Exit.HOLDS
    request = str(office / "operator-bob" / "kill-request.json")
    for name, passphrase in (("carol", "last"), ("dora", "first"), ("../office", "first")):
        with subtests.test("refused", name=name):
            assert ran(home, "approve", request, name, PASSPHRASE=passphrase).code == Exit.BAD_INPUT
    approved = ran(home, "approve", request, "carol", PASSPHRASE="first")
    assert approved.code == Exit.HOLDS
    assert "operator-bob may kill until" in " ".join(approved.err.split())
    found = home / "approver-carol" / "operator-bob"
    assert ran(office, "admit", request).code == Exit.BAD_INPUT
    admitted = ran(office, "admit", str(found / APPROVAL_FILE))
    assert admitted.code == Exit.HOLDS
    assert "next: copy" in admitted.err
    shown = ran(office, "show")
    assert "has to be approved" not in shown.err
    fingerprint = made.err.split("SHA-256:")[1].split()[0]
    assert fingerprint in shown.err.replace("\n", "")
