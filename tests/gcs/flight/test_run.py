"""The exit code of a flight, from the outcomes of its vehicles and the verdict on its record."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from agents.flight_end import FlightEnd, LastPosition
from agents.shell.outcome import Outcome
from gcs.errors import Exit
from gcs.flight.run import exit_code, report_abandoned
from gcs.link.ports import added_text
from gcs.mission.file import load_mission

MISSION = load_mission("case2")
TYPED = "case2", ("network.team=blue",)
COMPLETED = Outcome(FlightEnd.LANDED, flew=True)
REFUSED = Outcome(FlightEnd.REFUSED, "arming was denied", "see its preflight messages")


@pytest.mark.parametrize("verdict", [Exit.HOLDS, Exit.VERDICT_FAILED])
def test_the_verdict_counts_where_all_vehicles_completed_the_mission(verdict: Exit) -> None:
    assert exit_code(MISSION, {1: COMPLETED, 2: COMPLETED}, verdict) is verdict


@pytest.mark.parametrize("ending", [FlightEnd.OPERATOR, FlightEnd.PILOT])
def test_one_vehicle_that_ended_in_flight_decides(ending: FlightEnd, capsys: pytest.CaptureFixture[str]) -> None:
    outcome = Outcome(ending, "its reason", "its next step", flew=True)
    assert exit_code(MISSION, {1: COMPLETED, 2: outcome}, Exit.HOLDS) is Exit.ENDED_IN_FLIGHT
    out, err = capsys.readouterr()
    assert out == ""
    assert "vehicle 2" in err
    assert "its reason" in err
    assert "next: its next step" in err
    assert "vehicle 1" not in err


def test_a_team_of_which_none_took_off_was_refused() -> None:
    assert exit_code(MISSION, {1: REFUSED, 2: REFUSED}, Exit.VERDICT_FAILED) is Exit.REFUSED


def test_a_refusal_ends_the_others_in_flight() -> None:
    stopped = Outcome(FlightEnd.OPERATOR, "the operator ended the flight", flew=True)
    assert exit_code(MISSION, {1: REFUSED, 2: stopped}, Exit.VERDICT_FAILED) is Exit.ENDED_IN_FLIGHT


def test_a_vehicle_that_is_unaccounted_for_comes_first_with_its_last_position(
    capsys: pytest.CaptureFixture[str],
) -> None:
    stopped = Outcome(FlightEnd.OPERATOR, "the operator ended the flight", flew=True)
    lost = Outcome(
        FlightEnd.LOST, "its link was lost", "search", flew=True, unaccounted=LastPosition((0, 0, 8.0), 35.0)
    )
    exit_code(MISSION, {1: stopped, 2: lost}, Exit.HOLDS)
    err = capsys.readouterr().err
    origin = MISSION.frame
    assert f"{origin.latitude_deg:.5f}" in err
    assert f"{origin.longitude_deg:.5f}" in err
    assert "height 8.0 m" in err
    assert err.index("Vehicle 2") < err.index("vehicle 1")


@pytest.mark.parametrize("ended_by", [signal.SIGKILL, signal.SIGINT])
def test_the_command_that_reaches_a_joined_vehicle_is_named_if_its_process_was_killed(
    ended_by: signal.Signals, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    tmp_path.chmod(0o700)
    url = "udpin://127.0.0.1:14999"
    program = (
        "import sys\n"
        "from contextlib import suppress\n"
        "from gcs.link.ports import Claims\n"
        "from gcs.mission.file import enlarged_mission, load_mission\n"
        f"vehicle = {{'id': 4, 'start_m': (0.0, -8.0), 'url': '{url}'}}\n"
        "with suppress(KeyboardInterrupt), Claims() as claims:\n"
        "    claims.show_added(enlarged_mission(load_mission('case2'), vehicle))\n"
        "    print(flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as flies:
        assert flies.stdout is not None
        flies.stdout.readline()
        report_abandoned(MISSION, *TYPED)
        before, shown = capsys.readouterr().err, added_text(MISSION)
        flies.send_signal(ended_by)
    assert before == "", "it flies"
    assert shown is not None
    report_abandoned(MISSION, *TYPED)
    said = " ".join(capsys.readouterr().err.split())
    assert added_text(MISSION) is None
    command = f"`cordon recover case2 --set network.team=blue --add 4 --only 4 --start 0,-8 --url {url}`"
    assert (command in said) is (ended_by is signal.SIGKILL), said
    assert ("vehicle 4 had joined this flight" in said) is (ended_by is signal.SIGKILL)


def test_a_flight_imports_nothing_that_only_stubs_need() -> None:
    """The dialect alone takes 11 MB in the flying process."""
    program = "import sys, gcs.flight.run; print('pymavlink' in sys.modules, 'sitl.server.server' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"
