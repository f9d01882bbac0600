"""The flight for identification: what it asks for, that box and speed hold, and that it tells plants apart."""

from dataclasses import replace
from functools import cache
from math import hypot

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from agents.control.excitation import BOX_RESERVE, Steps, preview, programme
from agents.core import VehicleCore
from agents.inputs import Start, TacticEvent
from agents.safety.fence import Fence
from agents.settings.config import AgentConfig
from agents.settings.sections import ExcitationSettings
from agents.tactics import Event, Tactic
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import Telemetry, Vector
from gcs.flight.excitation import FlownExcitation, flown_excitation
from gcs.flight.simulated import fly_simulated
from gcs.metrics.record import FlightRecord
from gcs.mission.excitation import hull
from gcs.mission.file import excitation_mission, load_mission, parse_mission
from gcs.mission.mission import Mission
from tests.support.mission_text import content, faults, parsed, put
from tests.support.paths import MISSIONS

pytestmark = pytest.mark.slow

NAMES = ("case2", "px4-trio")
STEP_S = 0.01


@cache
def excited(name: str, vehicle_id: int = 1) -> Mission:
    return excitation_mission(load_mission(name), vehicle_id)


def config_of(mission: Mission) -> AgentConfig:
    return mission.agent_config(mission.vehicles[0])


def off(plant: Plant, a0: float, a1: float, delay_s: float | None = None) -> Plant:
    x, y = (PlantAxis(axis.a0_per_s2 * a0, axis.a1_per_s * a1) for axis in (plant.x, plant.y))
    return Plant(x, y, plant.delay_s if delay_s is None else delay_s)


@cache
def signal(config: AgentConfig) -> Vector:
    """The setpoints of the whole programme about the middle of the box, held from tick to tick, every STEP_S."""
    whole = programme(config)
    ticks = np.arange(0.0, whole.duration_s, 1.0 / config.rate_hz)
    held = [(0.0, 0.0) if part is None else part.offset_m(t) for t in ticks.tolist() for part in [whole.part(t)]]
    return np.repeat(np.array(held), round(1.0 / config.rate_hz / STEP_S), axis=0)


def answers(setpoints: Vector, a0: Vector, a1: Vector) -> tuple[Vector, Vector]:
    """Let many plants, alike on both axes or (2, N), answer to setpoints held for a step: what they do after it.

    Positions and velocities, (T, 2, N).
    """
    shape = (2, a0.shape[-1])
    stiffness, damping = np.broadcast_to(a0, shape), np.broadcast_to(a1, shape)
    places, speeds = np.empty((2, len(setpoints), *shape))
    for axis, plant in np.ndindex(shape):
        k, d = float(stiffness[axis, plant]), float(damping[axis, plant])
        for numerator, motion in (([k], places), ([k, 0.0], speeds)):
            (held,), denominator, _ = cont2discrete((numerator, [1.0, d, k]), STEP_S, method="zoh")
            motion[:, axis, plant] = lfilter(held[1:], denominator, setpoints[:, axis])
    return places, speeds


NARROW = {"half_width_m": 1.5, "speed_max_m_s": 5.0}


@pytest.mark.parametrize(("name", "changes"), [("case2", {}), ("px4-trio", {}), ("case2", NARROW)])
def test_box_and_speed_hold_on_every_plant_that_is_as_far_off_as_it_may_be(
    name: str, changes: dict[str, float]
) -> None:
    config, random = config_of(excited(name)), np.random.default_rng(3)
    assert config.excitation is not None
    settings = config.excitation.model_copy(update=changes)
    config = replace(config, excitation=settings)
    doubt = settings.plant_doubt
    corners = np.array([(-doubt, -doubt), (-doubt, doubt), (doubt, -doubt), (doubt, doubt)])
    shares = 1.0 + np.vstack([corners, random.uniform(-doubt, doubt, (20, 2))])
    a0, a1 = config.plant.x.a0_per_s2 * shares[:, 0], config.plant.x.a1_per_s * shares[:, 1]
    places, speeds = answers(signal(config), a0, a1)
    reach_m, speed_m_s = float(np.abs(places).max()), float(np.hypot(speeds[:, 0], speeds[:, 1]).max())
    assert reach_m <= settings.half_width_m
    assert speed_m_s <= 1.01 * settings.speed_max_m_s
    # It is not timid either: one of the plants needs nearly all that it may have.
    assert speed_m_s > 0.9 * settings.speed_max_m_s or reach_m > 0.9 * BOX_RESERVE * settings.half_width_m


def steadiness(setpoints: Vector, a0: float, a1: float) -> float:
    """The least of the singular values of what least squares sees of one axis, [u - p, -v], over the root of time."""
    places, speeds = answers(np.column_stack([setpoints, setpoints]), np.array([a0]), np.array([a1]))
    regressors = np.column_stack([setpoints - places[:, 0, 0], -speeds[:, 0, 0]])
    return float(np.linalg.svd(regressors, compute_uv=False)[-1] / np.sqrt(len(setpoints)))


@pytest.mark.parametrize("name", NAMES)
def test_both_axes_are_excited_enough_to_tell_stiffness_from_damping_at_every_frequency(name: str) -> None:
    config = config_of(excited(name))
    axis, setpoints = config.plant.x, signal(config)
    frequency_hz = np.fft.rfftfreq(len(setpoints), STEP_S)
    ramp = np.linspace(0.0, 0.5 * len(setpoints) * STEP_S, len(setpoints))
    for along in setpoints.T:
        rich = steadiness(along, axis.a0_per_s2, axis.a1_per_s)
        assert rich > 0.1
        assert rich > 5.0 * steadiness(ramp, axis.a0_per_s2, axis.a1_per_s), "a line tells nothing apart"
        power = np.abs(np.fft.rfft(along)) ** 2
        for low, high in ((0.05, 0.1), (0.1, 0.2), (0.2, 0.35), (0.35, 0.5)):
            band = (frequency_hz >= low) & (frequency_hz < high)
            assert power[band].sum() > 0.01 * power[1:].sum(), f"{low} to {high} Hz"


def correlation(pairs: Vector) -> float:
    along_x, along_y = pairs.T
    return float(along_x @ along_y / np.sqrt(along_x @ along_x * (along_y @ along_y)))


@pytest.mark.parametrize("name", NAMES)
def test_the_axes_do_not_say_the_same(name: str) -> None:
    setpoints = signal(config_of(excited(name)))
    assert abs(correlation(setpoints)) < 0.2
    config = config_of(excited(name))
    both = [part for part in programme(config).parts if None not in part.signals]
    assert len(both) == 2
    for part in both:
        during = np.array([part.offset_m(t) for t in np.arange(part.begin_s, part.end_s, STEP_S)])
        assert abs(correlation(during)) < 0.5


def test_another_seed_is_another_programme_and_the_same_is_the_same() -> None:
    config = config_of(excited("case2"))
    settings = config.excitation
    assert settings is not None
    other = replace(config, excitation=settings.model_copy(update={"seed": 1}))
    assert programme(other).parts[0] != programme(config).parts[0]
    programme.cache_clear()
    assert programme(replace(config)) == programme(config)


def test_levels_last_as_long_as_they_may_and_no_step_is_too_large() -> None:
    settings = config_of(excited("case2")).excitation
    assert settings is not None
    for part in programme(config_of(excited("case2"))).parts[:3]:
        for each in part.signals:
            if isinstance(each, Steps):
                lasted_s = np.diff(each.from_s)
                assert settings.level_shortest_s <= lasted_s.min()
                assert lasted_s.max() <= settings.level_longest_s
                assert np.abs(np.diff([0.0, *each.level])).max() <= 0.75
                assert np.abs(np.diff([0.0, *each.level])).min() > 0.0


def test_parts_do_not_overlap_and_rest_between() -> None:
    whole = programme(config_of(excited("case2")))
    ends = [0.0, *(part.end_s for part in whole.parts)]
    begins = [*(part.begin_s for part in whole.parts), whole.duration_s]
    assert min(np.subtract(begins, ends)) == pytest.approx(4.0)
    assert all(whole.part((end + begin) / 2.0) is None for end, begin in zip(ends, begins, strict=True))


def recorded(mission: Mission) -> FlightRecord:
    return fly_simulated(mission, 0, mission.mission.duration_s, lambda _: None)


@cache
def planned(name: str) -> FlightRecord:
    """The flight on the plant that it was planned for."""
    return recorded(excited(name))


@pytest.mark.parametrize("name", NAMES)
def test_what_is_flown_is_what_was_foreseen(name: str) -> None:
    mission = excited(name)
    foreseen, flown = preview(config_of(mission)), flown_excitation(mission, planned(name))
    assert flown.duration_s == pytest.approx(foreseen.duration_s, abs=0.2)
    assert flown.speed_m_s == pytest.approx(foreseen.speed_m_s, rel=0.01)
    assert flown.reach_m == pytest.approx(foreseen.reach_m, rel=0.01)
    assert flown.distance_m == pytest.approx(foreseen.distance_m, rel=0.05)
    assert flown.parts_missing == ()
    assert flown.guard_interventions == 0


@pytest.mark.parametrize(
    ("name", "wind", "a0", "a1", "delay_s"),
    [
        ("case2", (0.5, 0.3), 0.6, 0.6, 0.4),
        ("case2", (0.5, 0.3), 1.5, 1.5, 0.0),
        ("px4-trio", (-0.3, 0.4), 1.3, 0.7, 0.3),
    ],
)
def test_the_box_holds_in_wind_and_on_other_plants(
    name: str, wind: tuple[float, float], a0: float, a1: float, delay_s: float
) -> None:
    mission = excited(name)
    vehicle = replace(mission.vehicles[0], true_plant=off(mission.vehicles[0].plant, a0, a1, delay_s))
    simulation = mission.simulation.model_copy(update={"wind_m_s2": wind})
    flown = flown_excitation(mission, recorded(replace(mission, vehicles=(vehicle,), simulation=simulation)))
    assert flown.reach_m < mission.excitation.half_width_m
    assert flown.speed_m_s < mission.safety.speed_max_m_s * 1.25
    assert flown.parts_missing == ()


def test_what_was_not_seen_for_a_moment_spoils_no_figure_and_a_part_not_seen_is_missing() -> None:
    mission = excited("case2")
    record = planned("case2")
    first, second, *_ = programme(config_of(mission)).parts

    def flown(from_s: float, to_s: float) -> FlownExcitation:
        unseen = (record.time_s >= from_s) & (record.time_s < to_s)
        track = record.vehicles[0]
        seen_m = np.where(unseen[:, None], np.nan, track.position_m)
        return flown_excitation(mission, replace(record, vehicles=(replace(track, position_m=seen_m),)))

    whole = flown_excitation(mission, record)
    paused = flown(first.end_s, second.begin_s)
    assert replace(paused, duration_s=whole.duration_s, distance_m=whole.distance_m) == whole
    assert paused.distance_m == pytest.approx(whole.distance_m, rel=0.01)
    assert paused.duration_s == pytest.approx(whole.duration_s - (second.begin_s - first.end_s), abs=0.05)
    assert flown(second.begin_s, second.end_s).parts_missing == (second.name,)


class Flown:
    """A core and the plant that it believes in, with commands in between."""

    def __init__(self, mission: Mission) -> None:
        config = config_of(mission)
        self.core = VehicleCore(config)
        self.motion: Vector = np.array([*mission.vehicles[0].section.start_m, 0.0, 0.0])
        self.step = exact_step(config.plant, 1.0 / config.rate_hz)
        self.period_s = 1.0 / mission.mission.rate_hz
        self.now_s = 0.0

    @property
    def away_m(self) -> float:
        """From the middle of the box of case 2's vehicle 1."""
        return hypot(self.motion[0] - 12.0, self.motion[1] - 4.0)

    def fly(self, until_s: float) -> None:
        while self.now_s < until_s:
            x, y, x_rate, y_rate = self.motion.tolist()
            self.core.take(Telemetry(self.now_s, (x, y, 8.0), (x_rate, y_rate, 0.0)))
            output = self.core.tick(self.now_s)
            assert output.setpoint is not None
            self.motion = self.step.advance(self.motion, np.array(output.setpoint.position_m[:2]), np.zeros(2))
            self.now_s += self.period_s


def tactic(flight: Flown) -> Tactic:
    return flight.core.tactic


def test_one_that_was_held_flies_the_next_part_from_the_middle() -> None:
    mission = excited("case2")
    steps_x, steps_y, steps_both = programme(config_of(mission)).parts[:3]
    flight = Flown(mission)
    flight.core.take(Start(0.0))
    flight.fly(steps_x.begin_s + 10.0)
    assert tactic(flight) is Tactic.EXCITE
    assert flight.away_m > 0.5, "a step was being flown"
    flight.core.take(TacticEvent(Event.HOLD))
    flight.fly(steps_y.begin_s + 5.0)
    assert tactic(flight) is Tactic.HOLD
    flight.core.take(TacticEvent(Event.RESUME))
    assert tactic(flight) is Tactic.EXCITE, "not into the formation"
    flight.fly(steps_y.end_s - 0.5)
    assert flight.away_m < 0.05, "the rest of that part is left out"
    flight.fly(steps_both.begin_s + 1.4)
    assert flight.away_m > 0.5, "the next part is flown"


def test_a_vehicle_that_is_not_there_in_time_is_not_excited_elsewhere() -> None:
    mission = excited("case2")
    flight = Flown(mission)
    flight.core.take(Start(-programme(config_of(mission)).parts[0].begin_s))  # the first part begins at once, 12 m away
    flight.fly(25.0)
    assert flight.away_m < 0.05


def test_the_mission_of_the_log_is_the_mission_that_flew() -> None:
    mission = excited("px4-trio", 3)
    again = parse_mission(mission.text, MISSIONS, mission.profile_texts)
    assert again == mission
    assert config_of(again) == config_of(mission)
    assert again.ids == (3,)


def test_alone_it_needs_no_layers_and_no_target() -> None:
    avoids = put(put(content((MISSIONS / "px4-trio.toml").read_text()), ("safety", "keep_out_m"), 2.0), ("excite",), 3)
    config = config_of(parsed(avoids))
    assert config.take_off_altitude_m == config.return_altitude_m == config.altitude_m
    assert (config.formation.leader, config.safety.keep_out_m, config.safety.guard) == (3, 0.0, True)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({("excite",): 9}, ["excite: no vehicle has the id 9 (ids: 1, 2, 3)"]),
        (
            {("safety", "speed_max_m_s"): 1.5},
            ["excitation.speed_max_m_s: 2 m/s is more than safety.speed_max_m_s = 1.5 m/s"],
        ),
        (
            {("excitation", "sweep_to_hz"): 2.5},
            [
                "excitation.sweep_to_hz: 2.5 Hz is too fast for mission.rate_hz = 10 Hz: a period takes 5 setpoints or "
                "more"
            ],
        ),
        (
            {("excitation", "offset_m"): [4.0, 3.0]},
            ["excitation.offset_m: vehicle 2 starts 2.00 m from the box of vehicle 1 or the way there, less"],
        ),
        (
            {("safety", "fence_m"): [[-5.0, -20.0], [110.0, -20.0], [110.0, 8.0], [-5.0, 8.0]]},
            ["excitation.half_width_m: the box and the way there are 1.00 m outside of safety.fence_m at (7.0, 9.0)"],
        ),
        (
            {("excitation", "level_longest_s"): 1.0},
            ["excitation.level_longest_s: 1 must be more than level_shortest_s = 1.5"],
        ),
        (
            {("excitation", "sweep_to_hz"): 0.05},
            ["excitation.sweep_to_hz: 0.05 must be more than sweep_from_hz = 0.05"],
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(changes: dict[tuple[str | int, ...], object], expected: list[str]) -> None:
    mission = put(content(), ("excite",), 1)
    mission = put(mission, ("encirclement", "radius_m"), 5.0)
    mission = put(mission, ("target", "start_m"), [35.0, -8.0])
    for path, value in changes.items():
        mission = put(mission, path, value)
    told = faults(mission)
    assert len(told) == len(expected), told
    for fault, wanted in zip(told, expected, strict=True):
        assert fault.startswith(wanted)


def test_the_guard_keeps_it_in_its_box_on_its_way_and_below_its_speed() -> None:
    mission = excited("case2", 2)
    fence, safety = Fence(mission.safety.fence_m), mission.safety
    for corner in ((7.1, -4.9), (16.9, -4.9), (16.9, 4.9), (7.1, 4.9), (0.0, 0.0), (5.0, 0.0)):
        assert fence.contains(corner)
    for outside in ((17.1, 0.0), (12.0, 5.1), (12.0, -5.1), (0.0, 4.0), (0.0, -4.0), (-2.1, 0.0)):
        assert not fence.contains(outside)
    assert safety.speed_max_m_s == 2.0


def test_by_its_plant_file_it_stays_below_its_acceleration() -> None:
    config = config_of(excited("px4-trio"))
    gentle = ExcitationSettings(acceleration_max_m_s2=0.8)
    setpoints = signal(replace(config, excitation=gentle))
    a0, a1 = config.plant.a0_per_s2[:, None], config.plant.a1_per_s[:, None]
    places, speeds = answers(setpoints, a0, a1)
    pushed = a0 * (setpoints[1:, :, None] - places[:-1]) - a1 * speeds[:-1]
    assert 0.75 < float(np.hypot(pushed[:, 0], pushed[:, 1]).max()) < 0.81


def test_a_hull_holds_all_places_and_turns_one_way() -> None:
    places = [tuple(each) for each in np.random.default_rng(1).normal(size=(40, 2)).tolist()]
    corners = np.array(hull(places))
    edges = np.roll(corners, -1, axis=0) - corners
    for place in places:
        to_place = np.array(place) - corners
        assert (edges[:, 0] * to_place[:, 1] - edges[:, 1] * to_place[:, 0] > -1e-12).all()
    assert {tuple(corner) for corner in corners.tolist()} <= set(places)
