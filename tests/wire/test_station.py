"""`cordon station` as its users meet it: a process, its address, and its end; alone and beside a flight."""

import asyncio
import gzip
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from datetime import datetime
from math import dist
from pathlib import Path

import msgspec
import psutil
import pytest

from agents.ports import VehicleRefusedError
from gcs.flightlog.audit import AuditEntry, audit_line
from gcs.flightlog.reader import read_log
from gcs.metrics.ending import UNACCOUNTED
from gcs.station import station_process
from gcs.station.picture import FlightPicture
from gcs.station.station_process import run_station
from tests.support.mission_text import LOW
from tests.support.page.map_tiles import png, tile_folder
from tests.support.page.station import entered, received, requested, stream, tickets
from tests.support.paths import ROOT
from tests.support.wire import LOOPBACK, PATIENCE_S, cordon, free_port, until_now

pytestmark = pytest.mark.wire

END_S = 8.0
"""Ctrl-C ends a station within this time, on a busy computer."""


def lines_to(lines: Iterable[str], words: str) -> list[str]:
    """Return the lines that are printed up to the one with these words."""
    said = []
    for line in lines:
        said.append(line)
        if words in line:
            break
    return said


def is_listening(port: int) -> bool:
    with socket.socket() as attempt:
        return attempt.connect_ex((LOOPBACK, port)) == 0


async def test_without_a_flight_the_page_says_that_it_waits_and_ctrl_c_ends_it_at_once(
    mission_file: Callable[..., str],
) -> None:
    address = f"{LOOPBACK}:{free_port()}"
    with cordon("station", "--mission", mission_file("case2"), "--address", address) as process:
        assert process.stderr is not None
        port, secret = entered(process.stderr.readline())
        async with stream(port, secret) as page:
            assert (await received(page, "mission"))["operator"]["may"] == []
            while "no flight" not in (await received(page, "team"))["link"]:
                pass
            began_s = time.monotonic()
            process.send_signal(signal.SIGINT)
            out, err = await asyncio.to_thread(process.communicate, timeout=PATIENCE_S)
            assert time.monotonic() - began_s < END_S
        assert (process.returncode, out, err) == (0, "", "")


def test_a_flight_whose_page_cannot_be_served_does_not_begin(mission_file: Callable[..., str]) -> None:
    with socket.create_server((LOOPBACK, 0)) as other:
        taken = f"{LOOPBACK}:{other.getsockname()[1]}"
        flight = ("fly", mission_file("case2"), "--sitl", "--station", "--station-address", taken, "--no-log")
        with cordon(*flight) as process:
            out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (3, "")
    assert "cannot listen" in err
    assert "Traceback" not in err


async def test_a_simulation_is_shown_from_its_log_until_ctrl_c(
    mission_file: Callable[..., str], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    address, log = f"{LOOPBACK}:{free_port()}", tmp_path / "flight.mcap"
    image = png((0, 160, 0))
    tiles = str(tile_folder(tmp_path / "tiles", {(1, 1, 1): image}))  # elsewhere: south of the equator
    simulation = ("sim", mission_file("case2"), "--duration", "20", "--json", "--log", str(log))
    simulated = (*simulation, "--station", "--station-address", address, "--station-tiles", tiles)
    for arguments in (simulated, ("station", str(log), "--address", address, "--tiles", tiles)):
        with subtests.test(arguments[0]), cordon(*arguments) as process:
            assert process.stderr is not None
            said = lines_to(process.stderr, "page of")
            assert f"warning: map tiles {tiles}: no tile covers the mission's origin" in "".join(said)
            port, secret = entered(said[-1])
            async with stream(port, secret) as page:
                headers = {"Authorization": f"Bearer {tickets[page]}"}
                _, _, tile = await asyncio.to_thread(requested, port, "/tiles/1/1/1", headers=headers)
                assert tile == image
                _, _, packed = await asyncio.to_thread(requested, port, "/flight.json", headers=headers)
            flight = msgspec.json.decode(gzip.decompress(packed), type=FlightPicture)
            assert {each.vehicle_id for each in flight.mission.vehicles} == {1, 2, 3}
            assert flight.teams[-1].time_s == pytest.approx(20.0, abs=0.5)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == (1 if arguments is simulated else 0), "it is too short to be judged"
            assert [json.loads(each)["mission"] for each in out.splitlines()] in ([], ["case2"])
            assert "Traceback" not in err


@pytest.fixture
def hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let every page's process hang, by a module that Python imports at its start; return the file that it makes."""
    file = tmp_path / "hangs"
    (tmp_path / "sitecustomize.py").write_text(
        "import os, pathlib, signal, sys\n"
        "if os.environ.get('CORDON_STATION_PIPE'):\n"
        f"    pathlib.Path({str(file)!r}).touch()\n"
        "    signal.pause()\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    return file


def test_a_page_that_does_not_start_is_given_up(hangs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station_process, "START_TIMEOUT_S", 0.5)
    with (
        pytest.raises(VehicleRefusedError, match=r"page did not start within 0\.5 s"),
        run_station(["--mission", "case2"]),
    ):
        pytest.fail("it has started")
    assert not [each for each in psutil.Process().children() if "station" in each.cmdline()], hangs


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_flight_whose_page_does_not_start(
    mission_file: Callable[..., str], hangs: Path, sent: signal.Signals
) -> None:
    command = [sys.executable, "-m", "gcs", "fly", mission_file("case2"), "--sitl", "--station", "--no-log"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) as flight:
        until_now(hangs.exists, "the start of the page's process")
        (page,) = psutil.Process(flight.pid).children()
        try:
            flight.send_signal(sent)
            flight.communicate(timeout=PATIENCE_S)
            assert flight.returncode == 3
            assert not page.is_running()
        finally:
            flight.kill()
            with suppress(psutil.NoSuchProcess):
                page.kill()


CHECKLIST = (
    "[target]\n",
    '[[checklist]]\ntext = "Propellers tight"\n\n[[checklist]]\ntext = "Flag up"\nrequired = false\n\n[target]\n',
)


async def test_a_flight_arms_nothing_until_the_page_has_ticked_the_checklist(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    address, log = f"{LOOPBACK}:{free_port()}", tmp_path / "flight.mcap"
    path = mission_file("case2", LOW, CHECKLIST)
    flight = ("fly", path, "--sitl", "--speed", "max", "--duration", "5", "--log", str(log), "--weather", "gusts")
    with cordon(*flight, "--station", "--station-address", address) as process:
        assert process.stderr is not None
        port, secret = entered(process.stderr.readline())
        async with stream(port, secret) as page:
            shown = await received(page, "checklist")
            assert [each["text"] for each in shown["items"]] == ["Propellers tight", "Flag up"]
            assert [each["required"] for each in shown["items"]] == [True, False]
            waiting = await asyncio.to_thread(lines_to, process.stderr, "[ ] Propellers tight")
            assert "waiting for the checklist" in "".join(waiting)
            await asyncio.sleep(1.0)
            team = await received(page, "team")
            assert all(each["position_m"] is None or each["position_m"][2] < 0.5 for each in team["vehicles"])
            ticked_s = time.time()
            await page.send(json.dumps({"kind": "tick", "item": 0, "ticked": True}))
            while not (by := (await received(page, "checklist"))["items"][0]["by"]):
                pass
            _, err = await asyncio.to_thread(process.communicate)
    assert process.returncode in (0, 1), err
    entries = [each.read(AuditEntry) for each in read_log(log).run_records if each.kind is AuditEntry]
    (tick,) = [each for each in entries if each.event == "ticked"]
    assert (tick.operator, tick.command) == (by, 1)
    assert tick.did.startswith("Propellers tight (")
    assert abs(datetime.fromisoformat(tick.did.partition("(")[2].rstrip(")")).timestamp() - ticked_s) < PATIENCE_S
    assert by in audit_line(tick)
    with cordon("report", str(log)) as report:
        _, said = await asyncio.to_thread(report.communicate)
    assert "weather: gusts" in said


def test_a_wait_for_the_checklist_ends_at_ctrl_c_with_nothing_armed(mission_file: Callable[..., str]) -> None:
    path = mission_file("case2", LOW, CHECKLIST)
    with cordon("fly", path, "--sitl", "--speed", "max", "--no-log") as process:
        assert process.stderr is not None
        told = " ".join("".join(lines_to(process.stderr, "[ ] Propellers tight")).split())
        assert "nothing is armed" in told
        assert "--checklist-done NAME" in told
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 3, err
    assert "the operator ended the flight before take-off" in " ".join(err.split())
    assert "armed:" not in err


async def test_the_page_outlives_a_flight_whose_process_is_killed_and_says_what_controls_the_vehicles(
    mission_file: Callable[..., str], subtests: pytest.Subtests
) -> None:
    """A page stays with the vehicles' last state, until the operator closes it at the terminal."""
    address = f"{LOOPBACK}:{free_port()}"
    flight = ("fly", mission_file("case2", LOW), "--sitl", "--speed", "10", "--duration", "1000", "--no-log")
    with cordon(*flight, "--json", "--station", "--station-address", address) as process:
        assert process.stderr is not None
        assert process.stdout is not None
        port, secret = entered(process.stderr.readline())
        async with stream(port, secret) as page:
            while {each["tactic"] for each in (await received(page, "team"))["vehicles"]} != {"formation"}:
                pass
            (flying,) = [each for each in psutil.Process(process.pid).children() if "station" not in each.cmdline()]
            flying.kill()
            killed_s = time.time()
            # Until the supervisor's reason arrives, the page shows that all processes have ended.
            reason = f"the flying process {flying.pid} ended by signal 9"
            while (lost := (team := await received(page, "team"))["lost"]) is None or reason not in lost["reason"]:
                assert time.time() < killed_s + PATIENCE_S, lost
            with subtests.test("which vehicles, since when"):
                assert lost["vehicles"] == [1, 2, 3]
                assert killed_s - 2.0 < lost["since_wall_s"] <= time.time(), "not since its start"
            with subtests.test("what the autopilots do"):
                assert "COM_OBL_RC_ACT" in lost["autopilots"]
            with subtests.test("the last state, for longer than a flight without vehicles is shown"):
                places_m = [each["position_m"] for each in team["vehicles"]]
                while (team := await received(page, "team"))["wall_s"] < killed_s + 4.0:
                    pass
                assert [each["position_m"] for each in team["vehicles"]] == places_m
                assert {(each["is_stale"], each["has_ended"]) for each in team["vehicles"]} == {(True, False)}
                assert (team["lost"], team["ending"]) == ({**lost, "processes_ended": True}, "")
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            assert await asyncio.to_thread(process.wait, PATIENCE_S) == 4
        unaccounted = {each["vehicle"]: each for each in json.loads(process.stdout.read())["ended"]["unaccounted"]}
        with subtests.test("the last positions, on the page and in the result"):
            assert unaccounted.keys() == {1, 2, 3}
            for i, place_m in enumerate(places_m, 1):
                assert dist(unaccounted[i]["position_m"], place_m) < 10.0, "in half a second at ten times the speed"
                assert unaccounted[i]["latitude_deg"] is not None
        said = process.stderr.read()
        assert "Ended by signal 9: vehicles 1, 2 and 3" in said
        assert "stays open" in said
        assert not is_listening(port)


@pytest.mark.long
async def test_the_page_stays_open_for_a_vehicle_that_was_lost_in_the_air_until_its_recovery_is_confirmed(
    mission_file: Callable[..., str], subtests: pytest.Subtests
) -> None:
    """While the others land, and after the end of the flying process."""
    address = f"{LOOPBACK}:{free_port()}"
    flight = (
        "fly",
        mission_file("case2", LOW),
        "--sitl",
        "--speed",
        "3",
        "--duration",
        "20",
        "--fault",
        "link-cut@5:3",
    )
    with cordon(*flight, "--no-log", "--json", "--station", "--station-address", address) as process:
        assert process.stderr is not None
        assert process.stdout is not None
        port, secret = entered(process.stderr.readline())
        async with stream(port, secret) as page:
            last_m: list[float] = []
            while not (lost := (team := await received(page, "team"))["vehicles"][2])["is_unaccounted"]:
                assert not lost["has_ended"]
                last_m = last_m if lost["is_stale"] or lost["position_m"] is None else lost["position_m"]
            with subtests.test("where it was last"):
                assert dist(lost["position_m"], last_m) < 1.0
                assert (lost["alert"], lost["severity"]) == (UNACCOUNTED, "alarm")
            while (team := await received(page, "team"))["lost"] is None or not team["ending"]:
                assert team["vehicles"][2]["is_unaccounted"]
            lost = team["vehicles"][2]
            with subtests.test("after the end of the flight"):
                assert team["lost"]["vehicles"] == [3]
                assert [each["has_ended"] for each in team["vehicles"]] == [True, True, False]
                assert UNACCOUNTED in team["ending"]
            await page.send('{"kind": "recovered", "vehicle_id": 3}')
            while not (team := await received(page, "team"))["vehicles"][2]["has_ended"]:
                pass
            assert team["lost"] is None
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            assert await asyncio.to_thread(process.wait, PATIENCE_S) == 4
        ended = json.loads(process.stdout.read())["ended"]
        with subtests.test("in the result"):
            (unaccounted,) = ended["unaccounted"]
            assert (ended["how"], unaccounted["vehicle"]) == ("lost", 3)
            assert dist(unaccounted["position_m"], lost["position_m"]) < 0.01
        assert "Vehicle 3 is unaccounted for" in process.stderr.read()


def test_a_station_does_not_outlive_a_flight_that_is_killed(mission_file: Callable[..., str]) -> None:
    address = f"{LOOPBACK}:{free_port()}"
    flight = ("fly", mission_file("case2"), "--sitl", "--duration", "60", "--no-log")
    with cordon(*flight, "--station", "--station-address", address) as process:
        assert process.stderr is not None
        port, _ = entered(process.stderr.readline())
        process.kill()
        until_now(lambda: not is_listening(port), "the station's end")
