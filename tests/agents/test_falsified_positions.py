"""A vehicle of a simulated team lies about itself or about the target: judged by the truth of the simulation.

What the honest vehicles find out, and what they cannot: a lie that a vehicle could fly.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import cos, inf, sin

import msgspec
import numpy as np
import pytest

from agents.core import VehicleCore
from agents.inputs import TacticEvent
from agents.notes import Note
from agents.outputs import Outgoing, TickOutput
from agents.safety.failsafe import Condition
from agents.settings.config import AgentConfig
from agents.settings.sections import FailsafeSettings
from agents.tactics import Event
from agents.team.codec import encode
from agents.team.messages import BusMessage, CommandedRing, MemberState, TargetPackage
from estimation.state import POSITION
from gcs.flight.simulated import simulated_vehicles
from tests.support.mission_text import CASE2, Content, content, parsed
from tests.support.observed_flight import observed
from tests.support.paths import MISSIONS

pytestmark = pytest.mark.slow

LIAR = 3
CROSSING = (MISSIONS / "crossing.toml").read_text(encoding="utf-8")

Lie = Callable[[float, MemberState], list[MemberState]]
"""What a liar sends instead of a state, so long after its first lie."""


@dataclass(frozen=True)
class Scene:
    """A mission, from when on one vehicle lies, and for how long it is flown."""

    mission: Content
    from_s: float
    duration_s: float


def on_the_ring() -> Scene:
    """Case2 with a target that all see and encircle from the start: the ring has settled when the lies begin."""
    mission = content(CASE2)
    mission["target"]["start_m"] = [7.0, -4.0]
    return Scene(mission, 30.0, 50.0)


def crossing() -> Scene:
    """Four vehicles swap places through one point: they are about to meet when the lies begin."""
    return Scene(content(CROSSING), 5.0, 25.0)


class Liar(VehicleCore):
    """A core whose messages are not what it knows. One that `blocks` then stands where it is, and does not evade."""

    def __init__(self, lie: Lie, from_s: float, blocks: bool, config: AgentConfig) -> None:
        self._lies = config.vehicle_id == LIAR
        unguarded = config.safety.model_copy(update={"guard": False})
        super().__init__(replace(config, safety=unguarded) if self._lies and blocks else config)
        self._lie, self._from_s, self._blocks = lie, from_s, blocks

    def tick(self, now_s: float) -> TickOutput:
        if self._lies and self._blocks and now_s >= self._from_s:
            self.take(TacticEvent(Event.HOLD))
        output = super().tick(now_s)
        if not self._lies or now_s < self._from_s:
            return output
        sent = [
            Outgoing(each.topic, encode(lie))
            for each in output.messages
            for lie in self._told(each.received(), now_s - self._from_s)
        ]
        return msgspec.structs.replace(output, messages=tuple(sent))

    def _told(self, state: BusMessage, since_s: float) -> list[MemberState]:
        assert isinstance(state, MemberState)
        return self._lie(since_s, state)


@dataclass(frozen=True)
class Outcome:
    """What honest vehicles reported and from when, and how near vehicles truly came from the first lie on."""

    since_s: Mapping[str, float]
    honest_m: float
    liar_m: float
    separation_m: float
    target_off_m: float


def flown(lie: Lie, scene: Scene, *, blocks: bool = False) -> Outcome:
    mission = parsed(scene.mission)
    vehicles = simulated_vehicles(mission, 1, partial(Liar, lie, scene.from_s, blocks))
    since_s: dict[str, float] = {}
    target_off_m = [0.0]

    def observe(_tick: int, index: int, output: TickOutput) -> None:
        status = output.status
        if mission.ids[index] == LIAR:
            return
        if status.alert:
            since_s.setdefault(status.alert, status.time_s - scene.from_s)
        if status.target is not None and status.time_s > scene.from_s:
            x, y = mission.target.motion.position_m(status.time_s)
            target_off_m.append(float(np.hypot(status.target[0] - x, status.target[1] - y)))

    flight = observed(mission, 1, observe, duration_s=scene.duration_s, vehicles=vehicles)
    place_m = flight.motion[flight.time_s >= scene.from_s][..., POSITION]
    near_m = {
        (mission.ids[one], mission.ids[other]): float(
            np.linalg.norm(place_m[:, one] - place_m[:, other], axis=-1).min(initial=inf)
        )
        for one, other in combinations(range(len(mission.ids)), 2)
    }
    outcome = Outcome(
        since_s,
        min(away_m for pair, away_m in near_m.items() if LIAR not in pair),
        min(away_m for pair, away_m in near_m.items() if LIAR in pair),
        mission.safety.separation_m,
        max(target_off_m),
    )
    print("MEASURED", outcome)
    return outcome


def shifted(state: MemberState, x_m: float, y_m: float) -> MemberState:
    (x, y), (aim_x, aim_y) = state.position_m, state.aim_m
    return msgspec.structs.replace(state, position_m=(x + x_m, y + y_m), aim_m=(aim_x + x_m, aim_y + y_m))


def drifts(speed_m_s: float, *, admits_it: bool) -> Lie:
    """Drift sideways; the published velocity is that of the drift if it `admits_it`."""

    def lie(since_s: float, state: MemberState) -> list[MemberState]:
        drifted = shifted(state, 0.0, speed_m_s * since_s)
        x_rate, y_rate = drifted.velocity_m_s
        reported_m_s = (x_rate, y_rate + speed_m_s) if admits_it else (x_rate, y_rate)
        return [msgspec.structs.replace(drifted, velocity_m_s=reported_m_s)]

    return lie


def is_two(_since_s: float, state: MemberState) -> list[MemberState]:
    return [state, msgspec.structs.replace(shifted(state, 4.0, 3.0), time_s=state.time_s + 0.02)]


def is_elsewhere(since_s: float, state: MemberState) -> list[MemberState]:
    """Claim to be far away, and on a bearing that is another vehicle's."""
    return [shifted(each, 500.0, 0.0) for each in is_on_another_bearing(since_s, state)]


def is_on_another_bearing(_since_s: float, state: MemberState) -> list[MemberState]:
    if state.angle is None:
        return [state]
    angle = msgspec.structs.replace(state.angle, bearing_rad=state.angle.bearing_rad - 2.0)
    return [msgspec.structs.replace(state, angle=angle)]


FOUND = {
    "jumps once by 5 m": lambda _, state: [shifted(state, 5.0, 0.0)],
    "jumps about": lambda at_s, state: [shifted(state, 8.0 * cos(17.0 * at_s), 8.0 * sin(31.0 * at_s))],
    "drifts at 0.6 m/s, and reports a velocity without it": drifts(0.6, admits_it=False),
    "flies 15 m/s": lambda _, state: [msgspec.structs.replace(state, velocity_m_s=(15.0, 0.0))],
    "is in two places": is_two,
    "is far away, and on another's bearing": is_elsewhere,
    "rises by 20 m": lambda _, state: [msgspec.structs.replace(state, altitude_m=state.altitude_m + 20.0)],
}
SLOW = ("drifts at 0.6 m/s, and reports a velocity without it",)
NOT_FOUND = {
    "is on another's bearing": is_on_another_bearing,
    "drifts at 0.3 m/s, with the velocity of that": drifts(0.3, admits_it=True),
}
DOUBTFUL, GRACE_S = Condition.PEER_DOUBTFUL.value, FailsafeSettings().doubt_s


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        *((name, on_the_ring) for name in FOUND),
        ("jumps about", crossing),
    ],
)
def test_a_lie_that_no_vehicle_flies_is_found_and_all_keep_apart(name: str, scene: Callable[[], Scene]) -> None:
    outcome = flown(FOUND[name], scene())
    assert 0.0 <= outcome.since_s[DOUBTFUL] <= 6.5 + GRACE_S
    # A vehicle without any state that can be flown is silent. A claim that comes near counts as near.
    expected = {DOUBTFUL, Condition.PEER_SILENT.value, Condition.TOO_CLOSE.value}
    assert set(outcome.since_s) <= expected
    assert outcome.honest_m >= outcome.separation_m
    # A drift is found once it has gone as far as an honest estimate may.
    within_m = FailsafeSettings().doubt_m if name in SLOW else 0.0
    assert outcome.liar_m >= outcome.separation_m - within_m


@pytest.mark.parametrize(("name", "scene"), list(zip(NOT_FOUND, [on_the_ring, crossing], strict=True)))
def test_false_states_that_a_vehicle_could_fly_are_not_detected_and_the_others_keep_apart(
    name: str, scene: Callable[[], Scene]
) -> None:
    outcome = flown(NOT_FOUND[name], scene())
    assert DOUBTFUL not in outcome.since_s
    assert outcome.honest_m >= outcome.separation_m


def test_a_constant_offset_from_the_start_is_not_detected_and_the_others_keep_apart() -> None:
    outcome = flown(lambda _, state: [shifted(state, -5.0, 0.0)], replace(crossing(), from_s=0.0))
    assert DOUBTFUL not in outcome.since_s
    assert outcome.honest_m >= outcome.separation_m


def test_where_a_liar_was_last_is_kept_clear_of_and_where_it_could_have_flown_is_not_known() -> None:
    scene = replace(on_the_ring(), duration_s=85.0)  # by then the one behind has passed where it stands
    found = flown(is_elsewhere, scene, blocks=True)
    not_found = flown(drifts(0.3, admits_it=True), scene, blocks=True)
    assert found.since_s[DOUBTFUL] <= 1.0 + GRACE_S
    assert min(found.honest_m, found.liar_m) >= found.separation_m
    assert DOUBTFUL not in not_found.since_s
    assert not_found.honest_m >= not_found.separation_m
    assert not_found.liar_m < not_found.separation_m, "nothing on board of the others tells where it is"


def test_a_lie_about_the_target_does_not_move_the_estimates_of_those_who_see_it() -> None:
    def moved(since_s: float, package: TargetPackage) -> TargetPackage:
        x, y = package.position_m
        # At first within what a target could do, and surer of it than the others.
        return msgspec.structs.replace(package, position_m=(x, y - min(since_s, 15.0)), covariance_m2=(1e-4, 0.0, 1e-4))

    def lie(since_s: float, state: MemberState) -> list[MemberState]:
        return [msgspec.structs.replace(state, sightings=tuple(moved(since_s, each) for each in state.sightings))]

    scene = on_the_ring()
    scene.mission["target"]["sensor"]["noise_m"] = 0.3
    outcome = flown(lie, scene)
    assert Condition.SIGHTINGS_CONTRADICT.value in outcome.since_s
    assert outcome.target_off_m <= 8.0
    assert min(outcome.honest_m, outcome.liar_m) >= outcome.separation_m


@pytest.mark.parametrize("scene", [on_the_ring, crossing])
def test_teams_without_faults_raise_no_doubt_with_loss_delay_and_drift(scene: Callable[[], Scene]) -> None:
    mission = scene().mission
    mission["network"] = {"loss": 0.4, "delay_s": 0.2}
    mission["simulation"] = {"wander_m": 0.5, "position_noise_m": 0.1, "velocity_noise_m_s": 0.1, "gusts": True}
    mission["target"]["sensor"]["noise_m"] = 0.3
    outcome = flown(lambda _, message: [message], Scene(mission, 0.0, 60.0))
    assert outcome.since_s == {}


RING_M, ROOM_M = 10.0, 24.0
"""The radius of case2's ring, and how far the sides of the fence are from the target when the lies begin."""


@pytest.mark.parametrize(
    ("radii_m", "flown_m", "reason"),
    [
        ((500.0, 400.0), RING_M, "no ring of"),
        ((30.0, 28.0), RING_M, "leaves the fence"),
        ((15.0,), 15.0, ""),
    ],
)
def test_a_liar_that_publishes_rings_is_followed_only_where_an_operator_could_command(
    radii_m: tuple[float, ...], flown_m: float, reason: str
) -> None:
    """It changes what it publishes every second. A ring that is possible cannot be told from one that it missed."""
    scene = on_the_ring()
    scene.mission["mission"]["duration_s"] = scene.duration_s
    x, y = scene.mission["target"]["start_m"]
    scene.mission["safety"]["fence_m"] = [
        [x + along * ROOM_M, y + across * ROOM_M] for along, across in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    mission = parsed(scene.mission)

    def publishes(since_s: float, state: MemberState) -> list[MemberState]:
        radius_m = radii_m[int(since_s) % len(radii_m)]
        return [msgspec.structs.replace(state, ring=CommandedRing(radius_m, state.time_s))]

    vehicles = simulated_vehicles(mission, 1, partial(Liar, publishes, scene.from_s, False))
    events: list[Note] = []

    def observe(_tick: int, index: int, output: TickOutput) -> None:
        if mission.ids[index] != LIAR:
            events.extend(output.status.notes)

    flight = observed(mission, 1, observe, duration_s=scene.duration_s, vehicles=vehicles)
    target_m, _ = mission.target.motion.over(flight.time_s)
    honest = [index for index, each in enumerate(mission.ids) if each != LIAR]
    away_m = np.linalg.norm(flight.motion[..., POSITION] - target_m[:, None], axis=-1)[:, honest]
    assert away_m[flight.time_s > scene.duration_s - 5.0] == pytest.approx(flown_m, abs=0.4)
    refused = [each.text for each in events if each.text.startswith("refused the ring in vehicle 3's state")]
    assert all(reason in each for each in refused)
    assert bool(refused) is bool(reason)
