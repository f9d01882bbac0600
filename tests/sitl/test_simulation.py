"""The in-process simulation: its plants against the matrix exponential, its network against what was asked of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.linalg import expm

from estimation.plant.model import Plant, PlantAxis
from estimation.state import Sighting, Telemetry, Vector
from sitl.simulation.simulation import (
    LANDED_AFTER_S,
    Absence,
    Inputs,
    NetworkModel,
    SimulatedFlight,
    SimulatedVehicle,
    TelemetryNoise,
    VehicleModel,
    simulate,
)
from sitl.vehicle.imperfections import EstimatorDriftModel, Imperfections
from sitl.world import SensorModel, SimulatedSensor, TargetMotion

PLANT = Plant(PlantAxis(0.80, 0.87), PlantAxis(0.60, 1.10))
WIND = (0.1, -0.2)
RATE_HZ = 10.0


@dataclass
class Wanted:
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, ...] = ()


@dataclass
class Packet:
    payload: bytes
    decoded: int = 0

    def received(self) -> bytes:
        self.decoded += 1
        return self.payload


@dataclass
class Asked:
    setpoint: Wanted | None
    messages: list[Packet] = field(default_factory=list)


INPUTS = Inputs(lambda now_s, payload: ("message", now_s, payload), lambda *about: ("presence", *about))


class Recorder:
    """A core that asks for what it is told to, and writes down all it hears."""

    def __init__(
        self,
        course: Callable[[float], tuple[float, float] | None],
        packets: int = 0,
        velocity: Callable[[float], tuple[float, ...]] = lambda _: (),
    ) -> None:
        self.course = course
        self.velocity = velocity
        self.packets = packets
        self.telemetry: list[Telemetry] = []
        self.sightings: list[Sighting] = []
        self.heard: list[tuple[float, bytes]] = []
        self.presence: list[tuple[int, bool]] = []
        self.packed: list[Packet] = []
        self.sent = 0

    def take(self, item: object) -> None:
        match item:
            case Telemetry():
                self.telemetry.append(item)
            case Sighting():
                self.sightings.append(item)
            case ("message", float(now_s), bytes(payload)):
                self.heard.append((now_s, payload))
            case ("presence", int(vehicle_id), bool(present)):
                self.presence.append((vehicle_id, present))
            case _:
                pytest.fail(f"took {item}")

    def tick(self, now_s: float) -> Asked:
        place = self.course(now_s)
        messages = [Packet(f"{self.sent + number}".encode()) for number in range(self.packets)]
        self.sent += self.packets
        self.packed += messages
        return Asked(None if place is None else Wanted((*place, 8.0), self.velocity(now_s)), messages)


class Sensor:
    """Sees the target where the vehicle truly is, at whole seconds."""

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        return (Sighting(now_s, 1, position_m, (1.0, 0.0, 1.0), 0.5, 0.5),) if now_s % 1.0 == 0.0 else ()


def vehicle(
    core: Recorder,
    plant: Plant = PLANT,
    start_m: tuple[float, float] = (1.0, -2.0),
    noise: TelemetryNoise | None = None,
    wind: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> SimulatedVehicle[Asked]:
    model = VehicleModel(plant, start_m, 8.0, (seed, 2, 1), noise or TelemetryNoise(), wind)
    return SimulatedVehicle(model, core, Sensor())


def fly(
    vehicles: list[SimulatedVehicle[Asked]], duration_s: float, network: NetworkModel | None = None, seed: int = 0
) -> SimulatedFlight:
    return simulate(
        vehicles,
        network or NetworkModel(range_m=100.0),
        rate_hz=RATE_HZ,
        duration_s=duration_s,
        seed=seed,
        inputs=INPUTS,
        observe=lambda *_: None,
        progress=lambda _: None,
    )


def still(_: float) -> None:
    return None


def weave(now_s: float) -> tuple[float, float]:
    return 2.0 * np.sin(0.7 * now_s), 0.5 * now_s


def test_the_true_motion_is_exact_with_every_setpoint_acting_one_delay_later(subtests: pytest.Subtests) -> None:
    for delay_s in [0.035, 0.985]:
        with subtests.test(delay_s=delay_s):
            flow = np.zeros((6, 6))
            flow[:2, 2:4] = np.eye(2)
            flow[2:4, :2], flow[2:4, 2:4] = -np.diag(PLANT.a0_per_s2), -np.diag(PLANT.a1_per_s)
            flow[2:4, 4:] = np.eye(2)
            grid_s = 0.005
            response = expm(flow * grid_s)
            truth: list[Vector] = []
            motion = np.array([1.0, -2.0, 0.0, 0.0])
            for step in range(1001):
                if step % 20 == 0:
                    truth.append(motion)
                tick = (step - round(delay_s / grid_s)) // 20
                setpoint = np.array(weave(tick / RATE_HZ)) if tick >= 0 else np.array([1.0, -2.0])
                motion = (response @ np.concatenate([motion, PLANT.a0_per_s2 * setpoint + WIND]))[:4]

            flight = fly([vehicle(Recorder(weave), Plant(PLANT.x, PLANT.y, delay_s), wind=WIND)], 5.0)

            assert flight.time_s == pytest.approx(np.arange(51) / RATE_HZ)
            assert flight.motion[:, 0] == pytest.approx(np.array(truth), abs=1e-9)
            assert flight.tick_us.shape == (51, 1)


def gust(now_s: float) -> tuple[float, ...]:
    return 1.3 * np.cos(0.9 * now_s), -0.4, 0.0


def test_a_feed_forward_velocity_acts_as_in_the_equation(subtests: pytest.Subtests) -> None:
    """x'' = a0 (X_d - x) + a1 (g V_d - x'), by the matrix exponential over each tick."""
    for gain in [0.7]:
        with subtests.test(gain=gain):
            flow = np.zeros((6, 6))
            flow[:2, 2:4] = np.eye(2)
            flow[2:4, :2], flow[2:4, 2:4] = -np.diag(PLANT.a0_per_s2), -np.diag(PLANT.a1_per_s)
            flow[2:4, 4:] = np.eye(2)
            response = expm(flow / RATE_HZ)
            truth, motion = [], np.array([1.0, -2.0, 0.0, 0.0])
            for tick in range(51):
                truth.append(motion)
                setpoint, velocity = np.array(weave(tick / RATE_HZ)), np.array(gust(tick / RATE_HZ)[:2])
                push = PLANT.a0_per_s2 * setpoint + gain * PLANT.a1_per_s * velocity
                motion = (response @ np.concatenate([motion, push]))[:4]

            flight = fly([vehicle(Recorder(weave, velocity=gust), Plant(PLANT.x, PLANT.y, 0.0, gain))], 5.0)

            assert flight.motion[:, 0] == pytest.approx(np.array(truth), abs=1e-9)


def test_instruments_measure_the_truth_plus_the_given_noise() -> None:
    core, exact = Recorder(weave), Recorder(weave)
    flight = fly([vehicle(core, noise=TelemetryNoise(0.3, 0.05)), vehicle(exact)], 200.0)
    told = np.array([[*one.position_m[:2], *one.velocity_m_s[:2]] for one in exact.telemetry])
    assert told == pytest.approx(flight.motion[:, 1])
    noisy = np.array([[*one.position_m[:2], *one.velocity_m_s[:2]] for one in core.telemetry]) - flight.motion[:, 0]
    assert noisy.std(axis=0) == pytest.approx([0.3, 0.3, 0.05, 0.05], rel=4.0 / (2 * 2001) ** 0.5)
    assert noisy.mean(axis=0) == pytest.approx(0.0, abs=4.0 * 0.3 / 2001**0.5)
    assert {one.position_m[2] for one in core.telemetry} == {8.0}
    # A sensor travels with the true vehicle, not with what it believes.
    assert [one.position_m for one in core.sightings] == [tuple(place) for place in flight.motion[::10, 0, :2].tolist()]


def test_a_message_arrives_at_the_first_tick_after_its_delay(subtests: pytest.Subtests) -> None:
    for delay_s in [0.0, 0.1, 0.14]:
        with subtests.test(delay_s=delay_s):
            listener = Recorder(still)
            fly([vehicle(Recorder(still, packets=2)), vehicle(listener)], 3.0, NetworkModel(100.0, delay_s))
            late = max(int(np.ceil(round(delay_s * RATE_HZ, 6))), 1)
            expected = [
                (tick + late, f"{2 * tick + number}".encode()) for tick in range(31 - late) for number in range(2)
            ]
            assert [(round(time_s * RATE_HZ), payload) for time_s, payload in listener.heard] == expected


def test_each_copy_is_lost_on_its_own_in_the_share_stated() -> None:
    first, second, speaker = Recorder(still), Recorder(still), Recorder(still, packets=3)
    fly([vehicle(first), vehicle(speaker), vehicle(second)], 100.0, NetworkModel(100.0, loss=0.3))
    heard = [{payload for _, payload in listener.heard} for listener in (first, second)]
    sent = speaker.sent - 3  # those of the last tick never arrive
    spread = (0.3 * 0.7 / sent) ** 0.5
    for one in heard:
        assert len(one) / sent == pytest.approx(0.7, abs=4.0 * spread)
    assert len(heard[0] & heard[1]) / sent == pytest.approx(0.49, abs=4.0 * spread)
    assert speaker.heard == []


def test_a_message_is_decoded_once_for_all_receivers_and_not_without_receivers() -> None:
    cores = [Recorder(still, packets=1) for _ in range(4)]
    places = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (500.0, 0.0)]
    fly([vehicle(core, start_m=place) for core, place in zip(cores, places, strict=True)], 2.0, NetworkModel(10.0))
    assert [{packet.decoded for packet in core.packed} for core in cores] == [{1}, {1}, {1}, {0}]
    assert [len(core.heard) for core in cores] == [40, 40, 40, 0]


def test_who_hears_whom_follows_the_vehicles() -> None:
    """The first flies away from the second, which hears it up to the last tick in range."""

    def away(_: float) -> tuple[float, float]:
        return 80.0, 0.0

    goer, stayer = Recorder(away, packets=1), Recorder(still, packets=1)
    flight = fly([vehicle(goer, start_m=(0.0, 0.0)), vehicle(stayer, start_m=(0.0, 0.0))], 20.0, NetworkModel(30.0))
    apart_m = np.hypot(*(flight.motion[:, 0, :2] - flight.motion[:, 1, :2]).T)
    expected = [tick + 1 for tick in np.flatnonzero(apart_m <= 30.0).tolist() if tick < 200]
    assert 10 < len(expected) < 190
    for core in (goer, stayer):
        assert [round(at_s * RATE_HZ) for at_s, _ in core.heard] == expected


def test_links_have_a_range_and_a_loss_of_their_own() -> None:
    """Of 0 -> 1 everything arrives, of 1 -> 0 nothing, of 1 -> 2 a part; 0 and 2 are out of range of each other."""
    cores = [Recorder(still, packets=3) for _ in range(3)]
    places = [(0.0, 0.0), (20.0, 0.0), (40.0, 0.0)]
    range_m = np.array([[0.0, 25.0, 25.0], [25.0, 0.0, 25.0], [50.0, 15.0, 0.0]])
    loss = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.4], [1.0, 0.0, 0.0]])
    network = NetworkModel(range_m, 0.0, loss)
    fly([vehicle(core, start_m=place) for core, place in zip(cores, places, strict=True)], 100.0, network)
    sent = cores[0].sent - 3  # those of the last tick never arrive
    assert [len(core.heard) for core in cores[:2]] == [0, sent]
    assert len(cores[2].heard) / sent == pytest.approx(0.6, abs=4.0 * (0.6 * 0.4 / sent) ** 0.5)


# Agents that come and go


def team(absences: Sequence[Absence]) -> tuple[SimulatedFlight, Recorder, list[Recorder]]:
    """Fly two: the second, of id 2, is absent at times; return its cores, too, one for every time it is there."""
    other, cores = Recorder(still, packets=1), [Recorder(weave, packets=1)]

    def new_core() -> Recorder:
        cores.append(Recorder(still))
        return cores[-1]

    model = VehicleModel(PLANT, (1.0, -2.0), 8.0, (0, 2, 1), absences=absences)
    absent = SimulatedVehicle(model, cores[0], Sensor(), new_core)
    return fly([vehicle(other), absent], 40.0), other, cores


def test_an_absent_agent_neither_sends_nor_receives_and_its_vehicle_hovers() -> None:
    flight, other, (core,) = team([Absence(2, 10.0)])
    assert other.presence == [(2, False)]
    assert [each.time_s for each in core.telemetry][-1] == pytest.approx(9.9)
    assert max(now_s for now_s, _ in core.heard) == pytest.approx(9.9)
    assert max(now_s for now_s, _ in other.heard) <= 10.0
    there = flight.motion[100, 1, :2]
    assert flight.motion[-1, 1] == pytest.approx([*there, 0.0, 0.0], abs=1e-3)
    aloft_s = flight.time_s[flight.aloft[:, 1]]
    assert aloft_s.max() == pytest.approx(10.0 + LANDED_AFTER_S, abs=0.11)
    assert flight.aloft[:, 0].all()


def test_one_that_comes_back_has_a_new_core_at_rest_in_its_new_place() -> None:
    flight, other, (first, second) = team([Absence(2, 10.0, 30.0, (7.0, 8.0))])
    assert other.presence == [(2, False), (2, True)]
    assert len(first.telemetry) == 100
    assert second.telemetry[0].time_s == pytest.approx(30.0)
    assert second.telemetry[0].position_m[:2] == (7.0, 8.0)
    assert flight.motion[300, 1].tolist() == [7.0, 8.0, 0.0, 0.0]
    assert flight.aloft[300:, 1].all()


def test_one_that_comes_late_was_not_in_the_air_before() -> None:
    flight, other, (core,) = team([Absence(2, 0.0, 20.0, (7.0, 8.0))])
    assert other.presence == [(2, False), (2, True)]
    assert core.telemetry[0].time_s == pytest.approx(20.0)
    assert not flight.aloft[:200, 1].any()
    assert flight.aloft[200:, 1].all()


def test_a_sighting_is_made_from_the_true_place_and_given_from_the_reported_one() -> None:
    """Less the reported position of its own time it is the true way to the target, however late it comes."""
    model = VehicleModel(
        PLANT,
        (0.0, 0.0),
        8.0,
        seed=(1, 2, 1),
        noise=TelemetryNoise(),
        imperfections=Imperfections(estimator_drift=EstimatorDriftModel(0.5, 2.0)),
    )
    target_m, core = np.array([6.0, 3.0]), Recorder(weave)
    sensor = SimulatedSensor(1, SensorModel(100.0, 5.0, 0.0, 0.8, 0.2, delay_s=0.3), TargetMotion((6.0, 3.0)), 0.0, 1)
    flight = simulate(
        [SimulatedVehicle(model, core, sensor)],
        NetworkModel(100.0),
        rate_hz=RATE_HZ,
        duration_s=10.0,
        seed=1,
        inputs=INPUTS,
        observe=lambda *_: None,
        progress=lambda _: None,
    )
    reported_m = {telemetry.time_s: np.array(telemetry.position_m[:2]) for telemetry in core.telemetry}
    assert len(core.sightings) > 40
    for sighting in core.sightings:
        true_m = flight.motion[round(sighting.time_s * RATE_HZ), 0, :2]
        seen_m = np.array(sighting.position_m) - reported_m[sighting.time_s]
        np.testing.assert_allclose(seen_m, target_m - true_m, atol=1e-9)
