"""Vehicles on several rings, in closed loop: who flies where, when one is lost, assigned, or a ring is commanded.

`python -m tests.experiments.rings 100` and `ring_sequences` fly many more teams.
"""

from dataclasses import replace

import numpy as np
import pytest

from agents.core import VehicleCore
from agents.inputs import Message
from agents.notes import TacticChange
from agents.outputs import TickOutput
from agents.tactics import Tactic
from agents.team.messages import OperatorCommand, RingValues
from gcs.metrics.catalogue import OF_THE_RING
from gcs.metrics.metrics import evaluated
from gcs.mission.file import load_mission
from sitl.simulation.simulation import Absence, SimulatedFlight
from tests.experiments import ring_sequences
from tests.experiments.membership import separation_left_m
from tests.experiments.membership_scenes import Scene, flown
from tests.experiments.random_joins import recorded
from tests.experiments.rings import conditions, drawn, late, measured, on_rings, place_faults
from tests.support.mission_text import CASE2, Content, content, drawn_vehicle, faults, parsed

FOUR_TARGETS, STACK_WITH_A_LOSS, CONCENTRIC = 108, 102, 1000
"""Seeds of each kind."""
ABREAST, IN_TWO_DIRECTIONS = 4038, 6018
"""Seeds with the vehicles of one ring, and of two, near each other on their way in."""


@pytest.mark.parametrize("seed", [FOUR_TARGETS, STACK_WITH_A_LOSS, CONCENTRIC])
def test_every_vehicle_flies_on_a_ring_with_a_place_and_keeps_it(seed: int) -> None:
    assert measured(seed).reasons == []


@pytest.mark.parametrize("seed", [ABREAST, IN_TWO_DIRECTIONS])
def test_vehicles_keep_apart_on_their_way_to_the_rings(seed: int) -> None:
    """With plants that are up to 20 % off, noise, and late and lost messages."""
    scene = replace(drawn(seed), duration_s=20.0)
    assert separation_left_m(scene, flown(scene, seed)) > 0.0


def two_rings(places: tuple[int, int], radii_m: tuple[float, float] = (8.0, 8.0)) -> Content:
    """Return a mission of three vehicles whose plants are off, and two targets at rest, 45 m from each other."""
    mission, random = content(CASE2), np.random.default_rng(5)
    mission["decision"]["distance_max_m"] = 100.0
    mission["target"]["sensor"] |= {"range_m": 200.0, "noise_m": 0.1}
    mission["target"]["velocity_m_s"] = [0.0, 0.0]
    mission["targets"] = [{"name": "left", "start_m": [25.0, 22.5]}, {"name": "right", "start_m": [25.0, -22.5]}]
    mission["rings"] = [
        {"target": name, "places": count, "radius_m": radius_m, "angular_rate_rad_s": 0.1}
        for name, count, radius_m in zip(("left", "right"), places, radii_m, strict=True)
    ]
    mission["vehicles"] = [drawn_vehicle(random, slot, (0.0, 5.0 - 5.0 * slot), 0.1) for slot in range(3)]
    return mission


class Observed:
    """A flight: the ring of each vehicle at each tick, -1 off the rings, its tactics in order, and the true motion."""

    def __init__(self, scene: Scene) -> None:
        ticks = round(scene.duration_s * scene.mission.mission.rate_hz) + 1
        self.on = np.full((ticks, len(scene.mission.ids)), -1)
        self.tactics: dict[int, list[TacticChange]] = {i: [] for i in scene.mission.ids}
        self.commanded: dict[int, list[tuple[int, float]]] = {i: [] for i in scene.mission.ids}
        self.flight: SimulatedFlight = flown(scene, 3, self._observe)
        self._mission = scene.mission

    def _observe(self, tick: int, vehicle: int, output: TickOutput) -> None:
        status = output.status
        self.on[tick, vehicle] = status.ring if status.tactic is Tactic.ENCIRCLE else -1
        self.tactics[status.vehicle_id] += [note.tactic for note in status.notes if note.tactic is not None]
        rings = [note.ring for note in status.notes if note.ring is not None]
        self.commanded[status.vehicle_id] += [(each.ring, each.radius_m) for each in rings]

    def radii_m(self, ring: int, last_s: float = 10.0) -> dict[int, float]:
        """Return the mean distance of each vehicle on a ring from its true target at the end."""
        (x, y), time_s = self._mission.of_ring(ring).target.start_m, self.flight.time_s
        late = time_s > time_s[-1] - last_s
        away_m = np.hypot(self.flight.motion[late, :, 0] - x, self.flight.motion[late, :, 1] - y).mean(axis=0)
        return {i: float(away_m[index]) for index, i in enumerate(self._mission.ids) if self.on[-1, index] == ring}

    def least_m(self) -> float:
        """Return the smallest distance between two vehicles."""
        at_m = self.flight.motion[:, :, :2]
        return min(float(np.hypot(*(at_m[:, i] - at_m[:, j]).T).min()) for i in range(at_m.shape[1]) for j in range(i))


def assigned(vehicle: int, ring: int | None, at_s: float, number: int = 1) -> OperatorCommand:
    return OperatorCommand(at_s, "assign", vehicle, "tower", number, ring_number=ring)


def test_a_vehicle_that_is_assigned_goes_to_the_other_ring_and_one_there_makes_room() -> None:
    scene = Scene(parsed(two_rings((1, 2))), (), 150.0, 0.0, told=(assigned(1, 1, 60.0),))
    seen = Observed(scene)
    assert seen.on[590].tolist() == [0, 1, 1]
    assert sorted(seen.on[-1].tolist()) == [0, 1, 1]
    assert seen.on[-1, 0] == 1
    moved = int(np.flatnonzero(seen.on[-1] == 0)[0]) + 1
    for i in (1, moved):
        assert [(each.before, each.after) for each in seen.tactics[i]][-2:] == [
            ("encircle", "transit"),
            ("transit", "encircle"),
        ]
    assert len(seen.tactics[5 - moved]) == 2  # start and engagement: it stays
    assert {**seen.radii_m(0), **seen.radii_m(1)} == pytest.approx(dict.fromkeys((1, 2, 3), 8.0), abs=0.3)
    assert seen.least_m() > scene.mission.safety.separation_m


def test_a_vehicle_off_the_rings_is_not_on_its_assigned_one_yet() -> None:
    mission = parsed(two_rings((1, 2)))
    core = VehicleCore(mission.agent_config(mission.vehicles[0]))
    core.take(Message(1.0, assigned(1, 0, 1.0)))
    outcomes = [note.command for note in core.tick(1.1).status.notes if note.command is not None]
    assert [each.did for each in outcomes] == ["will go, once on its mission, to the ring 'left'"]


def test_commands_of_several_rings_are_flown_in_any_sequence() -> None:
    """Four vehicles on a stack of three rings, one ring commanded and four assignments."""
    assert ring_sequences.measured(3).reasons == []


def test_a_ring_that_loses_a_vehicle_closes_up_and_the_others_stay() -> None:
    scene = Scene(parsed(two_rings((1, 3))), (Absence(3, 60.0),), 100.0, 0.0)
    seen = Observed(scene)
    assert seen.on[590].tolist() == [0, 1, 1]
    assert seen.on[990, :2].tolist() == [0, 1]
    assert [len(changes) for changes in seen.tactics.values()] == [2, 2, 2]  # start and engagement


def test_four_targets_are_shared_when_a_vehicle_is_lost_and_one_target_becomes_unimportant() -> None:
    mission, late_s, lost = load_mission("four-targets"), 30.0, 5
    falls_s = mission.targets[1].changes[0][0]
    scene = Scene(mission, (Absence(lost, falls_s - 40.0),), falls_s + 40.0 + late_s, 0.0)
    record, flight, _ = recorded(scene, 3)
    on, judged, there = on_rings(record), late(record, late_s), scene.there(flight.time_s)[-1]
    before = on[:, record.time_s < falls_s - 41.0][:, -1]
    assert {*before.tolist()} == {0, 1, 2, 3}
    assert before[mission.ids.index(lost)] == 1
    assert place_faults(mission, on[:, judged], there) == []
    assert {*on[there][:, judged].ravel().tolist()} == {0, 2, 3}
    missed, tolerances = {each.name: each.value for each in conditions(mission, record, late_s)}, mission.verdicts
    assert missed["radius"] < tolerances.radius_error_rms_m
    assert missed["rate"] < tolerances.angular_rate_error_rad_s
    assert missed["spacing"] < tolerances.spacing_error_rms_deg
    assert separation_left_m(scene, flight) > 0.0
    result = evaluated(mission, record)
    assert (result.verdicts.separation, result.verdicts.engaged) == (True, True)
    assert [each.vehicle for each in result.departures or ()] == [lost]
    # The ring of the lost one was bent around it when its target became unimportant.
    assert all(result.rings[number].verdict(name) for number in (0, 2, 3) for name in OF_THE_RING)


def test_a_ring_is_commanded_alone_and_reaches_vehicles_that_only_hear_of_it() -> None:
    told = OperatorCommand(60.0, "ring", None, "tower", 1, ring=RingValues(radius_m=12.0), ring_number=1)
    scene = Scene(parsed(two_rings((1, 2))), (), 110.0, 0.0, told=(told,))
    seen = Observed(scene)
    assert seen.commanded == {i: [(1, 12.0)] for i in (1, 2, 3)}
    assert seen.radii_m(0) == pytest.approx({1: 8.0}, abs=0.3)
    assert seen.radii_m(1) == pytest.approx({2: 12.0, 3: 12.0}, abs=0.3)
    assert seen.least_m() > scene.mission.safety.separation_m


def overlapping(apart_m: float) -> Content:
    """Return three vehicles on two shared rings whose targets are this far from each other."""
    mission = two_rings((2, 2))
    for target, y_m in zip(mission["targets"], (apart_m / 2.0, -apart_m / 2.0), strict=True):
        target["start_m"] = [25.0, y_m]
    for ring in mission["rings"]:
        ring["shared"] = True
    return mission


def test_a_ring_never_has_more_vehicles_than_places_though_operators_assign_more() -> None:
    told = tuple(assigned(i, 0, 60.0, number=i) for i in (1, 2, 3))
    seen = Observed(Scene(parsed(two_rings((1, 2))), (), 120.0, 0.0, told=told))
    assert (seen.on[-200:] == 0).sum(axis=1).max() <= 1


def test_a_vehicle_assigned_to_a_ring_whose_target_is_not_seen_keeps_its_place() -> None:
    mission = two_rings((2, 2))
    mission["targets"][0]["sensor"] = {"range_m": 1.0}
    told = (assigned(2, 0, 60.0), assigned(3, 0, 60.0, number=2))
    seen = Observed(Scene(parsed(mission), (), 120.0, 0.0, told=told))
    assert (seen.on == 1).sum(axis=1).max() <= 2


def test_a_vehicle_comes_to_a_shared_ring_whose_target_is_inside_the_other_ring() -> None:
    scene = Scene(parsed(overlapping(6.0)), (), 150.0, 0.0, told=(assigned(1, 1, 60.0), assigned(2, 0, 60.0, number=2)))
    seen = Observed(scene)
    assert seen.on[-1, :2].tolist() == [1, 0]


def test_vehicles_engage_targets_that_one_of_them_names() -> None:
    """The others' sightings are associated."""
    mission = two_rings((1, 2))
    mission["target"]["sensor"]["names"] = False
    assert [each.partition(":")[0] for each in faults(mission)] == [f"targets[{k}].sensor.names" for k in (0, 1)]
    mission["vehicles"][1]["sensor"] = {"names": True}
    seen = Observed(Scene(parsed(mission), (), 70.0, 0.0))
    assert sorted(seen.on[-1].tolist()) == [0, 1, 1]
    assert {**seen.radii_m(0), **seen.radii_m(1)} == pytest.approx(dict.fromkeys((1, 2, 3), 8.0), abs=0.3)
