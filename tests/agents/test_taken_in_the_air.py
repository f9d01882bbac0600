"""A vehicle whose agent is gone hovers on the ring, forgotten by the others, and another agent takes it meanwhile."""

from math import dist

import numpy as np
import pytest

from agents.core import VehicleCore
from agents.inputs import ReceivedInput, TacticEvent
from agents.outputs import TickOutput
from agents.settings.config import AgentConfig
from agents.tactics import Event
from estimation.state import Telemetry
from gcs.flight.simulated import simulated_vehicles
from tests.support.mission_text import content, parsed
from tests.support.observed_flight import observed
from tests.support.paths import MISSIONS

CASE2 = (MISSIONS / "case2.toml").read_text(encoding="utf-8")
TAKEN, GONE_S, SHOWN_FOR_S, ENDS_S = 3, 45.0, 3.0, 110.0
OFF = 0.15


class Retaken(VehicleCore):
    """The cores of a vehicle's agents: until the first is gone, then nothing, then that of the one that takes it."""

    shown_s = taken_s = float("inf")

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        self._place: Telemetry | None = None
        self._next: VehicleCore | None = None

    def take(self, item: ReceivedInput) -> None:
        self._place = item if isinstance(item, Telemetry) else self._place
        core = self._next
        if core is None:
            super().take(item)
        else:
            core.take(item)

    def tick(self, now_s: float) -> TickOutput:
        if now_s < GONE_S:
            return super().tick(now_s)
        if now_s < self.shown_s:
            return TickOutput(None, (), super().tick(now_s).status)
        if self._next is None:
            self._next = VehicleCore(self._config)
            assert self._place is not None
            self._next.take(self._place)
        if now_s >= self.shown_s + SHOWN_FOR_S and self.taken_s > now_s:
            self.taken_s = now_s
            self._next.take(TacticEvent(Event.ADOPT))
        output = self._next.tick(now_s)
        return output if now_s > self.taken_s else TickOutput(None, output.messages, output.status)


@pytest.mark.parametrize("seed", range(3))
def test_others_that_pass_it_keep_the_separation(seed: int) -> None:
    draw = np.random.default_rng([31, seed])
    mission = content(CASE2)
    mission["encirclement"] |= {"radius_m": 8.0, "angular_rate_rad_s": float(draw.uniform(0.08, 0.15))}
    mission["target"] |= {"start_m": [14.0, 0.0], "velocity_m_s": [0.0, 0.0]}
    mission["target"]["sensor"]["range_m"] = mission["decision"]["distance_max_m"] = 200.0
    mission["safety"]["lost_avoided_s"] = 5.0
    for vehicle in mission["vehicles"]:
        vehicle["true_scale"] = dict(zip(("a0", "a1"), draw.uniform(1.0 - OFF, 1.0 + OFF, 2).tolist(), strict=True))
    team, shown_at_m, cores = parsed(mission), float(draw.uniform(5.0, 6.0)), list[Retaken]()

    def core(config: AgentConfig) -> VehicleCore:
        if config.vehicle_id != TAKEN:
            return VehicleCore(config)
        cores.append(Retaken(config))
        return cores[0]

    vehicles = simulated_vehicles(team, seed, core)

    def show(now_s: float) -> None:
        places_m = [each.motion[:2] for each in vehicles]
        if (
            now_s > GONE_S + 8.0
            and now_s < cores[0].shown_s
            and min(dist(places_m[2], each) for each in places_m[:2]) < shown_at_m
        ):
            cores[0].shown_s = now_s

    flight = observed(team, seed, duration_s=ENDS_S, vehicles=vehicles, progress=show)
    assert cores[0].taken_s < ENDS_S - 10.0
    away_m = np.hypot(*np.moveaxis(flight.motion[:, :2, :2] - flight.motion[:, 2:, :2], 2, 0)).min(axis=1)
    least_m = away_m[flight.time_s >= GONE_S].min()
    print(f"MEASURED shown at {shown_at_m:.1f} m, least {least_m:.2f} m")
    assert least_m >= team.safety.separation_m
