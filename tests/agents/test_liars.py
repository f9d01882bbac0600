"""A vehicle of a simulated team lies about itself or about the target: judged by the truth of the simulation.

What the honest vehicles find out, and what they cannot: a lie that a vehicle could fly. The liar itself flies on as
any other, and keeps clear of what it hears.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import cos, sin

import msgspec
import numpy as np
import pytest

from agents.core import VehicleCore
from agents.outputs import Outgoing, TickOutput
from agents.safety.failsafe import Condition
from agents.settings.config import AgentConfig
from agents.team.messages import MemberState, NeighbourAngle, TargetPackage, decode, encode
from estimation.state import POSITION
from gcs.flight.simulated import simulated_vehicles
from sitl.simulation.simulation import NetworkModel, simulate
from tests.support.mission_text import CASE2, Content, content, parsed

LIAR = 3
FROM_S, DURATION_S = 30.0, 75.0
LATE_S = FROM_S + 20.0

Peer = MemberState | NeighbourAngle | TargetPackage
Lie = Callable[[float, Peer], list[Peer]]
"""What a liar sends instead of a message at a time."""


class Liar(VehicleCore):
    """A core of which the liar's messages are not what it knows."""

    def __init__(self, lie: Lie, config: AgentConfig) -> None:
        super().__init__(config)
        self._lie = lie if config.vehicle_id == LIAR else None

    def tick(self, now_s: float) -> TickOutput:
        output = super().tick(now_s)
        if self._lie is None:
            return output
        sent = []
        for outgoing in output.messages:
            message = decode(outgoing.payload)
            lies = self._lie(now_s, message) if isinstance(message, Peer) else [message]
            sent += [Outgoing(outgoing.topic, encode(each)) for each in lies]
        return msgspec.structs.replace(output, messages=tuple(sent))


@dataclass(frozen=True)
class Told:
    """What the honest vehicles reported, when first, and how near vehicles truly came to each other."""

    alerts: frozenset[str]
    doubted_s: float | None
    honest_m: float
    liar_m: float
    separation_m: float
    target_off_m: float


def shifted(message: MemberState, x: float, y: float) -> MemberState:
    (px, py), (sx, sy) = message.position_m, message.setpoint_m
    return msgspec.structs.replace(message, position_m=(px + x, py + y), setpoint_m=(sx + x, sy + y))


def of_state(change: Callable[[float, MemberState], list[MemberState]]) -> Lie:
    def lie(now_s: float, message: Peer) -> list[Peer]:
        return [*change(now_s, message)] if isinstance(message, MemberState) else [message]

    return lie


def since(change: Callable[[float, MemberState], list[MemberState]]) -> Lie:
    return of_state(lambda now_s, state: [state] if now_s < FROM_S else change(now_s - FROM_S, state))


def case2() -> Content:
    """Return case2 with a target that all see and encircle from the start."""
    mission = content(CASE2)
    mission["target"]["start_m"] = [7.0, -4.0]
    return mission


def told(lie: Lie, mission: Content | None = None) -> Told:
    flown = parsed(case2() if mission is None else mission)
    vehicles = simulated_vehicles(flown, 1, partial(Liar, lie))
    alerts: set[str] = set()
    doubted_s: list[float] = []
    target_off_m = [0.0]

    def observe(_tick: int, index: int, output: TickOutput) -> None:
        status = output.status
        if flown.ids[index] == LIAR:
            return
        if status.alert:
            alerts.add(status.alert)
        if status.alert == Condition.PEER_DOUBTFUL.value:
            doubted_s.append(status.time_s)
        if status.target is not None and status.time_s > FROM_S:
            x, y = flown.target.motion.position_m(status.time_s)
            off_m = float(np.hypot(status.target[0] - x, status.target[1] - y))
            target_off_m.append(off_m)

    network = flown.network
    flight = simulate(
        vehicles,
        NetworkModel(network.range_m, network.delay_s, network.loss),
        rate_hz=flown.mission.rate_hz,
        duration_s=DURATION_S,
        seed=1,
        observe=observe,
        progress=lambda _: None,
    )
    place_m = flight.motion[flight.time_s >= FROM_S][..., POSITION]
    near_m = {
        (one, other): float(
            np.linalg.norm(place_m[:, flown.ids.index(one)] - place_m[:, flown.ids.index(other)], axis=-1).min()
        )
        for one, other in combinations(flown.ids, 2)
    }
    return Told(
        frozenset(alerts),
        min(doubted_s, default=None),
        min(away_m for pair, away_m in near_m.items() if LIAR not in pair),
        min(away_m for pair, away_m in near_m.items() if LIAR in pair),
        flown.safety.separation_m,
        max(target_off_m),
    )


def jumps(_since_s: float, state: MemberState) -> list[MemberState]:
    return [shifted(state, 5.0, 0.0)]


def jumps_about(since_s: float, state: MemberState) -> list[MemberState]:
    return [shifted(state, 8.0 * cos(17.0 * since_s), 8.0 * sin(31.0 * since_s))]


def drifts(speed_m_s: float, *, admitted: bool) -> Callable[[float, MemberState], list[MemberState]]:
    """Drift towards the others; `admitted`: the published velocity is that of the lie."""

    def lie(since_s: float, state: MemberState) -> list[MemberState]:
        drifted = shifted(state, 0.0, speed_m_s * since_s)
        x_rate, y_rate = drifted.velocity_m_s
        return [msgspec.structs.replace(drifted, velocity_m_s=(x_rate, y_rate + speed_m_s))] if admitted else [drifted]

    return lie


def is_fast(_since_s: float, state: MemberState) -> list[MemberState]:
    return [msgspec.structs.replace(state, velocity_m_s=(15.0, 0.0))]


def is_two(_since_s: float, state: MemberState) -> list[MemberState]:
    second = shifted(state, 4.0, 3.0)
    return [state, msgspec.structs.replace(second, time_s=state.time_s + 0.02)]


def rises(_since_s: float, state: MemberState) -> list[MemberState]:
    return [msgspec.structs.replace(state, altitude_m=state.altitude_m + 20.0)]


def is_far(now_s: float, message: Peer) -> list[Peer]:
    """Claim to be far away, and on the bearing of the vehicle behind."""
    if now_s < FROM_S:
        return [message]
    if isinstance(message, NeighbourAngle):
        return [msgspec.structs.replace(message, bearing_rad=message.bearing_rad - 2.0)]
    return [shifted(message, 500.0, 0.0)] if isinstance(message, MemberState) else [message]


def is_on_another_bearing(now_s: float, message: Peer) -> list[Peer]:
    if now_s < FROM_S or not isinstance(message, NeighbourAngle):
        return [message]
    return [msgspec.structs.replace(message, bearing_rad=message.bearing_rad - 2.0)]


FOUND = {
    "jumps once by 5 m": since(jumps),
    "jumps about": since(jumps_about),
    "drifts at 0.6 m/s, and reports a velocity without it": since(drifts(0.6, admitted=False)),
    "flies 15 m/s": since(is_fast),
    "is in two places": since(is_two),
    "is far away, and its bearing is another's": is_far,
    "rises by 20 m": since(rises),
}
NOT_FOUND = {
    "is 5 m off from the start": of_state(lambda _now_s, state: [shifted(state, -5.0, 0.0)]),
    "is on another's bearing": is_on_another_bearing,
    "drifts at 0.3 m/s, with the velocity of that": since(drifts(0.3, admitted=True)),
}


@pytest.mark.parametrize("name", FOUND)
def test_a_lie_that_no_vehicle_flies_is_found_and_all_keep_apart(name: str) -> None:
    flight = told(FOUND[name])
    print(name, flight)
    assert flight.doubted_s is not None
    assert FROM_S <= flight.doubted_s <= FROM_S + 8.0
    assert min(flight.honest_m, flight.liar_m) >= flight.separation_m
    # A vehicle without any state that can be flown is silent.
    assert flight.alerts <= {Condition.PEER_DOUBTFUL.value, Condition.PEER_SILENT.value}, "they fly on"


@pytest.mark.parametrize("name", NOT_FOUND)
def test_a_lie_that_a_vehicle_could_fly_is_not_found_and_the_honest_keep_apart(name: str) -> None:
    flight = told(NOT_FOUND[name])
    print(name, flight)
    assert flight.doubted_s is None
    assert flight.honest_m >= flight.separation_m


def test_a_lie_about_the_target_does_not_move_those_who_see_it() -> None:
    def lie(now_s: float, message: Peer) -> list[Peer]:
        if not isinstance(message, TargetPackage) or now_s < FROM_S:
            return [message]
        x, y = message.position_m
        # Within the reach of what a target could do, step by step, and then far.
        off_m = min(1.0 * (now_s - FROM_S), 15.0)
        return [msgspec.structs.replace(message, position_m=(x, y - off_m), covariance_m2=(1e-4, 0.0, 1e-4))]

    flight = told(lie)
    print(flight)
    assert Condition.SIGHTINGS_CONTRADICT.value in flight.alerts
    assert flight.target_off_m <= 3.0
    assert min(flight.honest_m, flight.liar_m) >= flight.separation_m


def test_honest_teams_raise_no_doubt_with_losses_delays_and_drifting_estimates() -> None:
    mission = case2()
    mission["network"] = {"loss": 0.4, "delay_s": 0.2}
    mission["simulation"] = {"wander_m": 0.5, "position_noise_m": 0.1, "velocity_noise_m_s": 0.1, "gusts": True}
    mission["target"]["sensor"]["noise_m"] = 0.3
    flight = told(of_state(lambda _now_s, state: [state]), mission)
    assert flight.alerts == frozenset()
