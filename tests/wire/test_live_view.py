"""What the live view of a flight shows, against the vehicles as they truly are; an alert that ends, and the end."""

from collections.abc import Callable, Sequence
from math import dist
from typing import Any

import pytest

from gcs.console.vehicle_view import TeamRow
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from sitl.autopilot.autopilot import StubAutopilot
from tests.support.flights import flying, in_flight, unseen_view
from tests.support.mission_text import LOW, LOW_M
from tests.support.wire import served, until

pytestmark = pytest.mark.wire

SPEED = 10.0
HALF_M = 30.0
RING_M_S = 0.05 * 10.0
NEAR = (
    ("distance_max_m = 12.0", "distance_max_m = 40.0"),
    ("range_m = 15.0", "range_m = 60.0"),
    ("start_m = [35.0, -5.0]", "start_m = [14.0, 0.0]"),
    ("velocity_m_s = [0.1, 0.0]", "velocity_m_s = [0.0, 0.0]"),
    ("[safety]\n", "[safety]\nfence_m = [[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]]\n"),
    LOW,
)
"""A ring that forms soon, within a square fence."""


class Shown:
    """What the live view has shown last, where the vehicles truly were then, and all its titles and lines."""

    def __init__(self, vehicles: dict[int, StubAutopilot]) -> None:
        self._vehicles = vehicles
        self.places_m: dict[int, tuple[float, float, float]] = {}
        self.rows: dict[int, TeamRow] = {}
        self.titles: list[str] = []
        self.lines: list[tuple[str, str]] = []

    def update(self, rows: Sequence[TeamRow], *rest: Any) -> None:
        self.rows = {row.vehicle_id: row for row in rows}
        self.places_m = {i: vehicle.airframe.position_m for i, vehicle in self._vehicles.items()}
        self.titles += rest[3:]

    def print_line(self, text: str, level: str = "information") -> None:
        self.lines.append((text, level))

    def flies_at(self, vehicle_id: int, speed_m_s: float) -> bool:
        shown_m_s = self.rows[vehicle_id].speed_m_s
        return shown_m_s is not None and abs(shown_m_s - speed_m_s) < 0.1

    def alerts(self) -> dict[int, str]:
        return {i: row.alert for i, row in self.rows.items() if row.alert}


async def test_rows_are_as_the_vehicles_are_and_an_alert_and_the_flight_end(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    mission = load_mission(mission_file("case2", *NEAR))
    view = unseen_view()
    async with served(stub_configs(mission), SPEED) as stubs:
        clock, faults, shown = stubs.clock, stubs.stubs[2].faults, Shown(stubs.vehicles)
        monkeypatch.setattr(view, "update", shown.update)
        monkeypatch.setattr(view, "print_line", shown.print_line)
        plan = FlightPlan(mission, 65.0, mission.vehicles, speed=SPEED, clock=clock.name)
        async with flying(plan, view) as flight:
            ring = "ring 3 of 3"
            await in_flight(flight, lambda: bool(shown.titles) and ring in shown.titles[-1], ring, clock)
            with subtests.test("numbers"):
                await until(
                    lambda: all(shown.flies_at(i, RING_M_S) for i in shown.rows),
                    80.0,
                    "the speed of the ring",
                    clock=clock,
                )
                places_m = {i: (x, y) for i, (x, y, _) in shown.places_m.items()}
                for i, row in shown.rows.items():
                    here_m = places_m[i]
                    others_m = {dist(here_m, place_m): k for k, place_m in places_m.items() if k != i}
                    assert row.height_m == pytest.approx(shown.places_m[i][2], abs=0.2)
                    assert row.height_m == pytest.approx(LOW_M, abs=0.5)
                    assert row.fence_margin_m == pytest.approx(HALF_M - max(map(abs, here_m)), abs=1.0)
                    assert row.nearest_m == pytest.approx(min(others_m), abs=1.0)
                    assert row.nearest_id is not None
                    nearest_m = dist(here_m, places_m[row.nearest_id])
                    assert nearest_m == pytest.approx(min(others_m), abs=1.0)
                    assert row.autopilot.gps_dimensions == 3
                    assert row.link_age_s is not None
                    assert row.link_age_s < 1.0
                assert "case2  T+" in shown.titles[-1]
            with subtests.test("an alert ends"):
                faults.estimator_ratio = 0.7
                await until(lambda: shown.alerts() == {2: "estimator degraded"}, 40.0, "the alert", clock=clock)
                faults.estimator_ratio = 0.0
                await until(lambda: not shown.alerts(), 40.0, "the end of the alert", clock=clock)
                graves = [grave for text, grave in shown.lines if "estimator degraded" in text]
                assert graves == ["warning", "information"]
            with subtests.test("an alert is over that holds its vehicle until it resumes"):
                faults.estimator_ratio = 1.5
                await until(lambda: shown.alerts() == {2: "estimator failing"}, 40.0, "the alert", clock=clock)
                change = shown.rows[2].next
                assert change is not None
                assert (change.does, change.cause) == ("lands", "mission's end"), "sooner than the next reaction"
                left_s = float(shown.titles[-1].partition(" s left")[0].rpartition(" ")[2])
                assert change.in_s == pytest.approx(left_s, abs=1.0)
                faults.estimator_ratio = 0.0
                await until(
                    lambda: shown.alerts() == {2: "waits for resume"}, 40.0, "the end of the condition", clock=clock
                )
                assert (shown.rows[2].tactic, shown.rows[2].severity) == ("hold", "alarm")
                assert shown.rows[2].advice.startswith("estimator failing is over: resume")
            await flight
    assert {row.ending for row in shown.rows.values()} == {"disarmed"}
    assert all(row.height_m == pytest.approx(0.0, abs=0.3) for row in shown.rows.values())
    assert "ring 0 of 3" in shown.titles[-1]
