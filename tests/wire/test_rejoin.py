"""A swap: a vehicle lands in mid-ring, its battery and its autopilot are new, and it rejoins the flight of its team.

The vehicles are stubs of this process, on a governed clock, with plants that differ from their profiles.
"""

import asyncio
import json
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from gcs.flightlog.reader import read_log
from gcs.report.flight_book import read_book
from gcs.station.recorded_flight import recorded_flight
from tests.support.served_team import UNLIKE, team_of
from tests.support.swaps import NEAR_TARGET, SETTLING_S, RingTruth, Tracks, commanded, ended, in_offboard, swap, told
from tests.support.wire import PATIENCE_S, hurried, running, until

pytestmark = pytest.mark.wire
ALL, OTHERS = (1, 2, 3), (1, 3)


@pytest.mark.long
async def test_a_vehicle_that_landed_with_a_low_battery_comes_back_into_the_ring(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    """It is refused while it flies and while its battery is empty; the log of it all is replayed bit for bit."""
    path, log = mission_file("case2", *UNLIKE, *NEAR_TARGET), tmp_path / "swap.mcap"
    async with (
        team_of(path) as team,
        asyncio.timeout(2.0 * PATIENCE_S),
        running("fly", path, "--log", str(log), "--json") as flight,
    ):
        tracks = Tracks(team)
        recording = asyncio.create_task(tracks.record())
        await in_offboard(team)
        with hurried(team.clock):
            await team.clock.sleep(1.5 * SETTLING_S)
        code, said = await told(team, 2)
        assert (code, "it has not landed" in said) == (3, True), said
        swapped = await swap(team, 2, emptied=True)
        with hurried(team.clock):
            await team.clock.sleep(1.5 * SETTLING_S)
        ends_s = team.clock.now_s()
        flight.send_signal(signal.SIGINT)
        await team.clock.sleep(1.0)
        code, said = await told(team, 2)
        assert (code, "it has not landed" in said) == (3, True), said
        out, err = await ended(team, flight, interrupts=1)
        recording.cancel()
    ring = RingTruth(team, log, tracks.samples)
    before = ring.figures(ALL, swapped.low_s - 5.0, swapped.low_s)
    between = ring.figures(OTHERS, swapped.rejoined_s - 5.0, swapped.rejoined_s)
    after = ring.figures(ALL, ends_s - 10.0, ends_s)
    even_s = ring.even_after_s(ALL, swapped.armed_s, ends_s)
    least_m = tracks.least_m(until_s=ends_s)
    print(f"MEASURED before: {before}\nbetween: {between}\nafter: {after}")
    print(f"even {even_s:.1f} s after its take-off; least distance {least_m:.2f} m")
    for each in (before, between, after):
        assert each.radius_off_m < 0.3
        assert each.spacing_off_deg < 3.0
    assert even_s < 45.0
    assert least_m >= team.mission.safety.separation_m
    result = json.loads(out)
    assert result["ended"]["how"] == "operator"
    left = [(each["vehicle"], each["cause"], each["back_at_s"] is not None) for each in result["departures"]]
    assert left == [(2, "battery low", True)]
    assert any("joins the others" in each["text"] for each in result["events"]), err
    async with running("replay", str(log)) as replay:
        replayed = b"".join(await replay.communicate())
        assert replay.returncode == 0, replayed.decode()
        assert b"compared bit for bit" in replayed
    ends = {at_s: end_if_killed(log, 2, at_s) for at_s in (swapped.low_s, swapped.rejoined_s, ends_s, inf)}
    assert list(ends.values()) == [None, "battery", None, "operator"], ends
    shown = recorded_flight(read_log(log)).events
    vehicles = [each.vehicle_id for each in shown if each.text.startswith("flight ended")]
    assert Counter(vehicles) == {1: 1, 2: 2, 3: 1}
    [booked] = read_book([log], lambda _share: None, with_verdicts=False).flights
    for flown in booked.vehicles:
        aloft_s = 0.1 * sum(flown.id in sample.places_m for sample in tracks.samples)
        assert flown.airborne_s == pytest.approx(aloft_s, abs=6.0), "its minutes are those of both flights"


def end_if_killed(log: Path, vehicle_id: int, at_s: float) -> str | None:
    """Return what the log says of the end of a vehicle's flight if the flying process is killed at a time."""
    whole = read_log(log)
    until_then = [each for each in whole.vehicles[vehicle_id] if each.time_ns * 1e-9 <= at_s]
    end = replace(whole, vehicles={vehicle_id: until_then}).end_of(vehicle_id)
    return None if end is None else end.how


FOURTH = """

[[vehicles]]
id = 4
url = "udpin://127.0.0.1:14543"
endpoint = "tcp/127.0.0.1:7464"
start_m = [0.0, -8.0]
reserve = true
"""
IN_RESERVE = ("start_m = [0.0, -4.0]\n", f"start_m = [0.0, -4.0]\n{FOURTH}")


@pytest.mark.long
async def test_a_reserve_takes_over_before_a_battery_is_low(mission_file: Callable[..., str], tmp_path: Path) -> None:
    """The relieved vehicle comes home once the other flies, so that the ring has never more members than before.

    The reserve is switched on only in mid-flight.
    """
    path, log = mission_file("case2", *NEAR_TARGET, IN_RESERVE), tmp_path / "reserve.mcap"
    async with (
        team_of(path) as team,
        asyncio.timeout(2.0 * PATIENCE_S),
        running("fly", path, "--log", str(log), "--json") as flight,
    ):
        tracks, flown = Tracks(team), [team.vehicles[i] for i in ALL]
        team.stubs.stubs[4].faults.link_cut = True
        flown[1].battery_fraction = 0.29
        recording = asyncio.create_task(tracks.record())
        await until(lambda: all(each.armed for each in flown), waiting_for="take-offs")
        with hurried(team.clock):
            await team.clock.sleep(20.0 + SETTLING_S)
            assert not team.vehicles[4].armed
            code, said = await told(team, 4)
            assert (code, "its link is lost" in said) == (3, True), said
            team.stubs.stubs[4].faults.link_cut = False
            code, said = await commanded(team, "command", "resume")
            assert code == 0, said
            await until(lambda: team.vehicles[4].armed, 60.0, "the reserve's take-off", clock=team.clock)
            low_s = team.clock.now_s()
            await until(lambda: not flown[1].armed, 200.0, "the landing of vehicle 2", clock=team.clock)
            await team.clock.sleep(10.0)
        ends_s = team.clock.now_s()
        out, err = await ended(team, flight)
        recording.cancel()
    ring = RingTruth(team, log, tracks.samples)
    before, after = ring.figures(ALL, low_s - 5.0, low_s), ring.figures((1, 3, 4), ends_s - 5.0, ends_s)
    even_s = ring.even_after_s((1, 3, 4), low_s, ends_s)
    print(f"MEASURED before: {before}\nafter: {after}\neven {even_s:.1f} s after its take-off")
    assert after.radius_off_m < 0.3
    assert after.spacing_off_deg < 3.0
    assert tracks.least_m(until_s=ends_s) >= team.mission.safety.separation_m
    result = json.loads(out)
    assert result["departures"] == [], "it was sent home before its battery was low"
    assert "in reserve, and not received: no heartbeat" in " ".join(err.split())
    assert "vehicle 4, in reserve, is received now" in err
    assert "is called from the reserve" in err
