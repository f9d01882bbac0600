"""Keys of flights on one computer: who makes them, who shares them, and what is left of them."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import NameOID

from agents.ports import VehicleRefusedError
from gcs.errors import InputError
from gcs.keys.run_keys import RunKeys
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S

HOLDER = """
import sys
from gcs.keys.run_keys import RunKeys
with RunKeys("team", (1, 2)).held():
    print("held", flush=True)
    sys.stdin.readline()
"""
KEYS = RunKeys("team", (1, 2))


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return this test's own runtime directory."""
    folder = tmp_path / "runtime"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return folder / "cordon"


@contextmanager
def flight() -> Iterator["subprocess.Popen[str]"]:
    """Hold the keys in another process."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def authority() -> bytes:
    security = KEYS.identity("operator").security
    assert security is not None
    return security.authority_pem


def test_processes_of_one_team_share_them_and_the_last_removes_them(runtime: Path) -> None:
    with pytest.raises(VehicleRefusedError, match="no flight of team team"):
        KEYS.identity("operator")
    with flight() as first:
        made = authority()
        assert (runtime / "team").stat().st_mode & 0o777 == 0o700
        with flight() as second:
            first.communicate("\n", PATIENCE_S)
            assert authority() == made, "the second had keys of its own"
            second.communicate("\n", PATIENCE_S)
    assert list(runtime.iterdir()) == []
    with KEYS.held():
        assert authority() != made
    assert list(runtime.iterdir()) == []


def test_what_a_killed_process_leaves_counts_for_nothing_and_is_replaced(runtime: Path) -> None:
    with flight() as process:
        made = authority()
        process.kill()
    assert (runtime / "team").is_dir(), "it has to be left, or this shows nothing"
    with pytest.raises(VehicleRefusedError, match="no flight of team team"):
        KEYS.identity("operator")
    with KEYS.held():
        assert authority() != made


def test_all_processes_of_a_run_fly_its_vehicles_with_one_certificate(runtime: Path) -> None:
    with KEYS.held():
        (both,), (second,) = KEYS.flying((1, 2)), KEYS.flying((2,))
        assert (both.vehicle_ids, second.vehicle_ids) == ((1, 2), (2,))
        assert both.security is not None
        assert both.security == second.security
        assert [path.name for path in (runtime / "team").glob("vehicle-*")] == ["vehicle-1"]
        certificate = x509.load_pem_x509_certificate(both.security.certificate_pem)
        grants = {grant.common_name: grant for grant in both.security.grants}
        (name,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        own = grants.pop(str(name.value))
        assert own.presence == ("alive/1", "alive/2")
        assert sorted(own.topics) == sorted(
            f"{topic}/{i}" for topic in ("@report", "answer", "head", "member", "roster", "start") for i in (1, 2)
        )
        others = [topic for grant in grants.values() for topic in (*grant.topics, *grant.presence)]
        assert not [
            topic
            for topic in others
            if not topic.startswith(("command/", "operator/", "perception/", "position/", "roster/"))
        ]


def test_other_vehicles_under_the_same_name_are_refused() -> None:
    with KEYS.held():
        with RunKeys("team", (2,)).held():
            pass
        with RunKeys("another", (3,)).held():
            pass
        with pytest.raises(VehicleRefusedError, match="without 3"), RunKeys("team", (2, 3)).held():
            pass


def test_a_directory_that_others_may_write_to_is_refused(runtime: Path, subtests: pytest.Subtests) -> None:
    runtime.mkdir(mode=0o755)
    with subtests.test(directory="open"), pytest.raises(InputError, match="chmod 700"), KEYS.held():
        pass
    if os.geteuid() == 0:
        runtime.chmod(0o700)
        os.chown(runtime, 12345, 12345)
        with subtests.test(directory="another user's"), pytest.raises(InputError, match="another user"), KEYS.held():
            pass
    runtime.rmdir()
    elsewhere = runtime.parent / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    runtime.symlink_to(elsewhere)
    with subtests.test(directory="a link"), pytest.raises(InputError, match="not a folder"), KEYS.held():
        pass


def test_without_a_runtime_directory_they_are_in_the_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with KEYS.held():
        assert (tmp_path / f"cordon-{os.geteuid()}" / "team").is_dir()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a folder to another user")
@pytest.mark.parametrize("made", ["folder", "link", "file"])
def test_where_another_user_has_made_it_they_are_below_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: str
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    squatted = tmp_path / f"cordon-{os.geteuid()}"
    match made:
        case "folder":
            squatted.mkdir(mode=0o700)
        case "link":
            squatted.symlink_to(tmp_path)
        case "file":
            squatted.touch()
    os.chown(squatted, 12345, 12345, follow_symlinks=False)
    with KEYS.held():
        (folder,) = (tmp_path / "home" / ".local" / "state" / "cordon").iterdir()
        assert (folder / "team").is_dir()
        assert folder.stat().st_mode & 0o777 == 0o700
        assert KEYS.identity("operator").may


def test_a_directory_that_is_removed_in_flight_ends_nothing(runtime: Path) -> None:
    with KEYS.held():
        subprocess.run(["rm", "-r", str(runtime)], check=True)


def test_one_that_joins_a_flight_makes_none_and_speaks_for_the_vehicle_it_adds(runtime: Path) -> None:
    joining = RunKeys("team", (1, 2), added=4)
    with pytest.raises(VehicleRefusedError, match="no flight of team team runs"), joining.held(joins=True):
        pass
    assert not (runtime / "team").exists()
    with flight():
        before = authority()
        with joining.held(joins=True):
            assert authority() == before
            assert [each.vehicle_ids for each in joining.flying((4,))] == [(4,)]
            holders = joining.holders()
            assert holders is not None
            assert {name for each in holders for name in each.vehicles} == {"1", "2", "4"}
        other = RunKeys("team", (1, 3), added=4)
        with pytest.raises(VehicleRefusedError, match="without 3"), other.held(joins=True):
            pass
