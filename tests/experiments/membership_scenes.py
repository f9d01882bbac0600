"""The scenes of membership.py, with members that join, leave and are lost, each from a seed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import cos, inf, pi, sin, tau

import numpy as np
from numpy.typing import NDArray

from agents.core import VehicleCore
from agents.inputs import Message, ReceivedInput
from agents.outputs import TickOutput
from agents.settings.config import AgentConfig
from agents.settings.shapes import Shape
from agents.team.messages import OperatorCommand
from estimation.state import Vector
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.mission import Mission
from sitl.simulation.simulation import Absence, SimulatedFlight
from tests.support.mission_text import Content, content, drawn_vehicle, parsed
from tests.support.observed_flight import observed
from tests.support.paths import MISSIONS

FIELD = (MISSIONS / "case2-field.toml").read_text(encoding="utf-8")
CHANGE_S = 60.0
PLANT_OFF_MOST = 0.2


@dataclass(frozen=True)
class Scene:
    """A scene: its mission, the absences, its duration, and the begin of settling.

    Spacings have to settle, and radii to within `radius_share` of the ring's; where a vehicle was lost the ring is
    bent, and radii are not checked. `told` are the operators' commands to the team with their times. The radio of
    `unheard_id` fails at `CHANGE_S` in both directions.
    """

    mission: Mission
    absences: tuple[Absence, ...]
    duration_s: float
    from_s: float
    radius_share: float = 0.05
    told: tuple[OperatorCommand, ...] = ()
    unheard_id: int | None = None

    @property
    def shape(self) -> Shape | None:
        """The final shape of the formation, None for the mission's."""
        return next((command.shape for command in reversed(self.told) if command.shape is not None), None)

    @property
    def gone(self) -> set[int | None]:
        """The vehicles that are not members at the end."""
        lost = {absence.vehicle_id for absence in self.absences if absence.to_s == inf}
        return lost | {self.unheard_id} | {command.vehicle for command in self.told}

    def there(self, time_s: Vector) -> NDArray[np.bool_]:
        """Return which agents are present (T, N)."""
        there = np.ones((time_s.size, len(self.mission.ids)), dtype=np.bool_)
        for absence in self.absences:
            away = (time_s >= absence.from_s) & (time_s < absence.to_s)
            there[away, self.mission.ids.index(absence.vehicle_id)] = False
        return there


class _CutOff(VehicleCore):
    """An agent that receives nothing from the vehicle with the failed radio; that vehicle receives nothing."""

    def __init__(self, unheard_id: int, config: AgentConfig) -> None:
        super().__init__(config)
        self._unheard_id, self._hears = unheard_id, config.vehicle_id != unheard_id

    def take(self, item: ReceivedInput) -> None:
        if isinstance(item, Message) and item.now_s >= CHANGE_S:
            sender = None if isinstance(item.message, OperatorCommand) else item.message.sender
            if not self._hears or sender == self._unheard_id:
                return
        super().take(item)


def flown(
    scene: Scene, seed: int, observe: Callable[[int, int, TickOutput], None] = lambda *_: None
) -> SimulatedFlight:
    """Fly a scene; `observe` takes tick, vehicle and output."""
    core = VehicleCore if scene.unheard_id is None else partial(_CutOff, scene.unheard_id)
    vehicles = simulated_vehicles(scene.mission, seed, core, scene.absences)
    told = list(scene.told)

    def tell(now_s: float) -> None:
        while told and now_s >= told[0].time_s:
            command = told.pop(0)
            for vehicle in vehicles:
                if vehicle.present:
                    vehicle.core.take(Message(now_s, command))
                    if command.verb in ("formation", "ring"):
                        break  # one vehicle receives it; it reaches the others in peers' states

    return observed(scene.mission, seed, observe, duration_s=scene.duration_s, vehicles=vehicles, progress=tell)


def field(
    random: np.random.Generator,
    starts_m: list[tuple[float, float]],
    *,
    radius_m: float,
    rate_rad_s: float,
    target_m: tuple[float, float],
) -> Content:
    """Return case2-field with this many vehicles, which all see the target and want to encircle it."""
    mission = content(FIELD)
    course_rad, speed_m_s = float(random.uniform(0.0, tau)), float(random.uniform(0.0, 0.2))
    mission["encirclement"] |= {"radius_m": radius_m, "angular_rate_rad_s": rate_rad_s}
    mission["tuning"] = {"encirclement": {"radius_far_m": 3.0 * radius_m}}
    mission["decision"]["distance_max_m"] = 200.0
    mission["target"] |= {
        "start_m": list(target_m),
        "velocity_m_s": [speed_m_s * cos(course_rad), speed_m_s * sin(course_rad)],
    }
    mission["target"]["sensor"]["range_m"] = 200.0
    mission["network"] |= {"delay_s": float(random.uniform(0.0, 0.15)), "loss": float(random.uniform(0.0, 0.3))}
    vehicles = (drawn_vehicle(random, slot, start_m, PLANT_OFF_MOST) for slot, start_m in enumerate(starts_m))
    mission["vehicles"] = list(vehicles)
    return mission


def abreast(count: int) -> list[tuple[float, float]]:
    return [(0.0, ((count - 1) / 2.0 - slot) * 5.0) for slot in range(count)]


def beside_target(mission: Content, at_s: float, bearing_rad: float, away_m: float) -> tuple[float, float]:
    """Return the place at a bearing and a distance from the target's position at a time."""
    (x, y), (x_rate, y_rate) = mission["target"]["start_m"], mission["target"]["velocity_m_s"]
    return float(x + x_rate * at_s + away_m * cos(bearing_rad)), float(y + y_rate * at_s + away_m * sin(bearing_rad))


def tight(
    random: np.random.Generator, count: int, *, radius_least_m: float, rate_least_rad_s: float
) -> tuple[Content, float]:
    """Return a mission about a ring with little room to spare for this many vehicles, and the ring's radius."""
    radius_m = max(radius_least_m, float(random.uniform(1.5, 2.5)) * 3.0 / (2.0 * sin(pi / count)))
    rate = drawn_rate(random, rate_least_rad_s, min(0.15, 1.5 / radius_m))
    return field(random, abreast(count), radius_m=radius_m, rate_rad_s=rate, target_m=(radius_m + 4.0, -5.0)), radius_m


def drawn_rate(random: np.random.Generator, least: float, most: float) -> float:
    return float(random.uniform(least, most) * random.choice([-1.0, 1.0]))


def loss_on_the_ring(seed: int) -> Scene:
    """Three on the ring; one agent ends."""
    random = np.random.default_rng([1, seed])
    mission = field(random, abreast(3), radius_m=10.0, rate_rad_s=drawn_rate(random, 0.05, 0.15), target_m=(14.0, -5.0))
    lost = Absence(int(random.integers(1, 4)), CHANGE_S)
    return Scene(parsed(mission), (lost,), 130.0, CHANGE_S, radius_share=inf)


def cut_off_on_the_ring(seed: int) -> Scene:
    """Three to eight on the ring; one's radio fails, and it flies on until it detects that."""
    random = np.random.default_rng([9, seed])
    count = int(random.integers(3, 9))
    mission, _ = tight(random, count, radius_least_m=10.0, rate_least_rad_s=0.05)
    unheard_id = int(random.integers(1, count + 1))
    return Scene(parsed(mission), (), 130.0, CHANGE_S, radius_share=inf, unheard_id=unheard_id)


def leave_the_ring(seed: int) -> Scene:
    """Three to eight on the ring; one is commanded to hold there, or to land."""
    scene, random = cut_off_on_the_ring(seed), np.random.default_rng([12, seed])
    return replace(scene, unheard_id=None, told=(told_off(random, int(random.choice(scene.mission.ids))),))


def told_off(random: np.random.Generator, vehicle_id: int) -> OperatorCommand:
    return OperatorCommand(CHANGE_S, "hold" if random.random() < 0.5 else "land", vehicle_id, "tower", 0)


def alone_on_the_ring(seed: int) -> Scene:
    """One vehicle on a ring, about its own sightings of the target with an error of half a metre."""
    random = np.random.default_rng([13, seed])
    mission = field(random, abreast(1), radius_m=10.0, rate_rad_s=drawn_rate(random, 0.05, 0.15), target_m=(14.0, -5.0))
    mission["formation"]["leader"] = 1
    return Scene(parsed(mission), (), 100.0, 0.0, radius_share=0.1)


def second_on_the_ring(seed: int) -> Scene:
    """One alone on the ring; another one starts outside of it."""
    scene = join_on_the_ring(seed)
    (comer,) = scene.absences
    alone = next(vehicle_id for vehicle_id in scene.mission.ids if vehicle_id != comer.vehicle_id)
    mission = scene.mission
    vehicles = tuple(each for each in mission.vehicles if each.id in (comer.vehicle_id, alone))
    formation = mission.formation.model_copy(update={"leader": alone})
    return replace(
        scene, mission=replace(mission, vehicles=vehicles, formation=formation), absences=(replace(comer, from_s=0.0),)
    )


def join_on_the_ring(seed: int) -> Scene:
    """Two on the ring; a third starts outside of it, or returns there."""
    random = np.random.default_rng([2, seed])
    mission = field(random, abreast(3), radius_m=10.0, rate_rad_s=drawn_rate(random, 0.05, 0.15), target_m=(14.0, -5.0))
    bearing_rad, away_m = random.uniform(0.0, tau), random.uniform(14.0, 30.0)
    place_m = beside_target(mission, CHANGE_S, bearing_rad, away_m)
    left_s = float(random.choice([0.0, 20.0]))
    comer = Absence(int(random.integers(1, 4)), left_s, CHANGE_S, place_m)
    return Scene(parsed(mission), (comer,), 130.0, CHANGE_S)


def leader_lost(seed: int) -> Scene:
    """Three to six in formation; the leader's agent ends."""
    random = np.random.default_rng([3, seed])
    count = int(random.integers(3, 7))
    mission = field(random, abreast(count), radius_m=10.0, rate_rad_s=0.05, target_m=(14.0, -5.0))
    leader = int(random.integers(1, count + 1))
    mission["target"]["threat"] = 0.9
    mission["formation"] |= {"leader": leader, "speed_m_s": float(random.uniform(0.1, 1.0))}
    return Scene(parsed(mission), (Absence(leader, CHANGE_S),), 100.0, CHANGE_S)


def leader_cut_off(seed: int) -> Scene:
    """Three to six in formation; the leader's radio fails, and it flies on until it detects that."""
    scene = leader_lost(seed)
    return replace(scene, absences=(), unheard_id=scene.mission.formation.leader)


def leader_back(seed: int) -> Scene:
    """Three to six in formation; the leader's agent ends, and restarts behind the formation."""
    scene = leader_lost(seed)
    (lost,), random = scene.absences, np.random.default_rng([6, seed])
    back_s = CHANGE_S + float(random.uniform(10.0, 30.0))
    speed_m_s = scene.mission.formation.speed_m_s
    place_m = speed_m_s * back_s - float(random.uniform(8.0, 16.0)), float(random.uniform(-10.0, 10.0))
    return replace(scene, absences=(replace(lost, to_s=back_s, at_m=place_m),), duration_s=150.0, from_s=back_s)


def reshaped(seed: int) -> Scene:
    """Three to six in one shape are commanded to change to another."""
    scene, random = leader_lost(seed), np.random.default_rng([7, seed])
    before, after = random.permutation(["line", "column", "wedge"])[:2].tolist()
    told = ((0.0, before), (CHANGE_S, after))
    commands = (OperatorCommand(at_s, "formation", None, "tower", number, to) for number, (at_s, to) in enumerate(told))
    return replace(scene, absences=(), told=tuple(commands), duration_s=120.0)


def follower_joins(seed: int) -> Scene:
    """One alone in formation, or up to five; one more starts behind."""
    random = np.random.default_rng([10, seed])
    count = int(random.integers(2, 7))
    mission = field(random, abreast(count), radius_m=10.0, rate_rad_s=0.05, target_m=(14.0, -5.0))
    leader, speed_m_s = int(random.integers(1, count + 1)), float(random.uniform(0.1, 1.0))
    mission["target"]["threat"] = 0.9
    mission["formation"] |= {"leader": leader, "speed_m_s": speed_m_s}
    comer = (leader + int(random.integers(1, count)) - 1) % count + 1
    place_m = speed_m_s * CHANGE_S - float(random.uniform(8.0, 16.0)), float(random.uniform(-10.0, 10.0))
    return Scene(parsed(mission), (Absence(comer, 0.0, CHANGE_S, place_m),), 120.0, CHANGE_S)


def follower_leaves(seed: int) -> Scene:
    """Three to six in formation; one that does not lead is commanded to hold, or to land."""
    scene, random = leader_lost(seed), np.random.default_rng([11, seed])
    others = [vehicle_id for vehicle_id in scene.mission.ids if vehicle_id != scene.mission.formation.leader]
    return replace(scene, absences=(), told=(told_off(random, int(random.choice(others))),))


def sixteen(seed: int) -> Scene:
    """Sixteen in a line encircle one target."""
    random = np.random.default_rng([4, seed])
    target_m = float(random.uniform(20.0, 60.0)), float(random.uniform(-20.0, 20.0))
    mission = field(random, abreast(16), radius_m=40.0, rate_rad_s=drawn_rate(random, 0.02, 0.05), target_m=target_m)
    return Scene(parsed(mission), (), 200.0, 0.0)


def two_groups(seed: int) -> Scene:
    """Two groups approach one target from two sides, at first out of each other's radio range."""
    random = np.random.default_rng([8, seed])
    here, there = (int(each) for each in random.integers(1, 5, 2))
    away_m = float(random.uniform(30.0, 40.0))
    starts = [(0.0, y) for _, y in abreast(here)] + [(away_m * 2.0, y) for _, y in abreast(there)]
    rate = drawn_rate(random, 0.05, 0.12)
    mission = field(random, starts, radius_m=12.0, rate_rad_s=rate, target_m=(away_m, 0.0))
    mission["network"]["range_m"] = 40.0
    return Scene(parsed(mission), (), 120.0, 0.0)


def coming_and_going(seed: int) -> Scene:
    """Up to ten at a ring with little spare room: some start late, some are lost, some of these return."""
    random = np.random.default_rng([5, seed])
    count = int(random.integers(4, 11))
    mission, radius_m = tight(random, count, radius_least_m=8.0, rate_least_rad_s=0.04)
    absences = []
    for vehicle_id in random.permutation(count)[: count // 2] + 1:
        bearing_rad, away_m = random.uniform(0.0, tau), radius_m + random.uniform(10.0, 25.0)
        from_s = float(random.choice([0.0, 5.0 * random.integers(8, 14)]))
        back_s = float(random.choice([CHANGE_S * 2.0 - random.integers(0, 40), inf])) if from_s else CHANGE_S
        place_m = None if back_s == inf else beside_target(mission, back_s, bearing_rad, away_m)
        absences.append(Absence(int(vehicle_id), from_s, back_s, place_m))
    last_s = max(time_s for absence in absences for time_s in (absence.from_s, absence.to_s) if time_s < inf)
    return Scene(parsed(mission), tuple(absences), 240.0, last_s, radius_share=inf)


# Each with whether it is flown in formation, and its limit of the settling time [s].
SCENES: dict[str, tuple[Callable[[int], Scene], bool, float]] = {
    "3 -> 2 on the ring": (loss_on_the_ring, False, 40.0),
    "told to leave the ring": (leave_the_ring, False, 60.0),
    "cut off on the ring": (cut_off_on_the_ring, False, 60.0),
    "alone on the ring": (alone_on_the_ring, False, 60.0),
    "1 -> 2 on the ring": (second_on_the_ring, False, 60.0),
    "2 -> 3 on the ring": (join_on_the_ring, False, 60.0),
    "leader lost in formation": (leader_lost, True, 20.0),
    "leader cut off in formation": (leader_cut_off, True, 20.0),
    "told to leave the formation": (follower_leaves, True, 20.0),
    "one more in formation": (follower_joins, True, 45.0),
    "leader back in formation": (leader_back, True, 45.0),
    "another shape": (reshaped, True, 45.0),
    "16 on a ring of 40 m": (sixteen, False, 180.0),
    "two groups at one target": (two_groups, False, 90.0),
    "coming and going": (coming_and_going, False, 60.0),
}
