"""Flights of a known plant, simulated by other code than identification uses."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, lfilter

from estimation.identification.excerpts import MotionRecording
from estimation.state import Vector

FINE_S = 0.002
SENT_S = 0.04


@dataclass(frozen=True)
class Truth:
    """The true plant."""

    a0: tuple[float, float]
    a1: tuple[float, float]
    delay_s: float
    feedforward: float = 0.0


def excitation_m(random: np.random.Generator, steps_s: float = 90.0, circle_s: float = 60.0) -> Vector:
    """Return setpoints (n, 2) at SENT_S: random steps within 3 m, then a circle at rising speed."""
    columns = []
    for _ in range(2):
        column: list[float] = []
        while len(column) < steps_s / SENT_S:
            column += [random.uniform(-3.0, 3.0)] * round(random.uniform(1.5, 6.0) / SENT_S)
        columns.append(column[: round(steps_s / SENT_S)])
    time_s = np.arange(0.0, circle_s, SENT_S)
    phase = 0.15 * time_s + 0.5 * 0.015 * time_s**2
    circle = 3.0 * np.column_stack((np.cos(phase), np.sin(phase)))
    return np.vstack((np.column_stack(columns), circle))


def circle_velocity_m_s(setpoint_m: Vector) -> Vector:
    """Return the velocities (n, 2) of such setpoints: the circle's, and none with steps, which take three fifths."""
    velocity = np.gradient(setpoint_m, SENT_S, axis=0)
    velocity[: round(0.6 * len(setpoint_m)) + 1] = 0.0
    return np.asarray(velocity)


def coloured(random: np.random.Generator, count: int, step_s: float, deviation_m: float, memory_s: float) -> Vector:
    """Return noise (count,) of a standard deviation with the correlation time `memory_s`."""
    keep = np.exp(-step_s / memory_s)
    white = random.normal(size=count) * np.sqrt(1.0 - keep**2)
    white[0] = random.normal()
    return np.asarray(deviation_m * lfilter([1.0], [1.0, -keep], white))


def flown(
    truth: Truth, setpoint_m: Vector, lag_s: float = 0.0, velocity_m_s: Vector | None = None
) -> tuple[Vector, Vector]:
    """Return times and positions (T, 2) at FINE_S of the plant, with an optional lag, under setpoints every SENT_S."""
    count = round(setpoint_m.shape[0] * SENT_S / FINE_S)
    time_s = np.arange(count) * FINE_S
    at = np.clip(np.floor((time_s - truth.delay_s) / SENT_S + 1e-9).astype(int), 0, setpoint_m.shape[0] - 1)
    columns = []
    for axis in range(2):
        a0, a1 = truth.a0[axis], truth.a1[axis]
        denominator = [lag_s, 1.0, a1, a0] if lag_s else [1.0, a1, a0]
        above, below, _ = cont2discrete(([a0], denominator), FINE_S)[:3]
        held = setpoint_m[at, axis]
        columns.append(held[0] + lfilter(above.ravel(), below, held - held[0]))
        if velocity_m_s is not None:
            push = truth.feedforward * a1 / a0 * velocity_m_s[at, axis]
            columns[-1] = columns[-1] + lfilter(above.ravel(), below, push)
    return time_s, np.column_stack(columns)


def recorded(
    truth: Truth,
    seed: int,
    *,
    noise_m: float = 0.05,
    memory_s: float = 1.0,
    setpoints_hz: float = 20.0,
    positions_hz: float = 50.0,
    setpoint_m: Vector | None = None,
    sampled: bool = True,
    lag_s: float = 0.0,
    fed: bool = False,
) -> MotionRecording:
    """Return the log of an excitation flight: noisy positions, and sampled setpoints.

    If `fed`, velocities are sent with them, whether the vehicle uses these or not.
    """
    random = np.random.default_rng(seed)
    sent_m = excitation_m(random) if setpoint_m is None else setpoint_m
    velocity_m_s = circle_velocity_m_s(sent_m) if fed else None
    time_s, position_m = flown(truth, sent_m, lag_s, velocity_m_s)
    every = round(1.0 / positions_hz / FINE_S)
    time_s, position_m = time_s[::every], position_m[::every]
    noise = [coloured(random, time_s.size, 1.0 / positions_hz, noise_m, memory_s) for _ in range(2)]
    begin_s = random.uniform(0.0, 1.0 / setpoints_hz) if sampled else 0.0
    sampled_s = np.arange(begin_s, time_s[-1], 1.0 / setpoints_hz)
    held = np.floor(sampled_s / SENT_S + 1e-9).astype(int)
    return MotionRecording(
        time_s,
        position_m + np.column_stack(noise),
        sampled_s,
        sent_m[held],
        [(0.0, float(time_s[-1]))],
        sampled=sampled,
        velocity_m_s=None if velocity_m_s is None else velocity_m_s[held],
    )


def saturated(
    truth: Truth, seed: int, *, speed_max_m_s: float = np.inf, acceleration_max_m_s2: float = np.inf
) -> MotionRecording:
    """Return the log of half such a flight, with bounded speed and acceleration along each axis."""
    random = np.random.default_rng(seed)
    sent_m = excitation_m(random, 45.0, 30.0)
    step_s, late = 0.01, round(truth.delay_s / 0.01)
    a0, a1 = np.array(truth.a0), np.array(truth.a1)
    position, velocity, path = sent_m[0].copy(), np.zeros(2), []
    for at in range(round(sent_m.shape[0] * SENT_S / step_s)):
        path.append(position)
        asked = sent_m[max(0, at - late) * sent_m.shape[0] // round(sent_m.shape[0] * SENT_S / step_s)]
        wished = np.clip(a0 / a1 * (asked - position), -speed_max_m_s, speed_max_m_s)
        push = np.clip(a1 * (wished - velocity), -acceleration_max_m_s2, acceleration_max_m_s2)
        velocity = velocity + push * step_s
        position = position + velocity * step_s
    every = round(0.02 / step_s)
    position_m = np.array(path)[::every]
    noise = np.column_stack([coloured(random, position_m.shape[0], 0.02, 0.05, 1.0) for _ in range(2)])
    time_s = np.arange(position_m.shape[0], dtype=np.float64) * 0.02
    sent_s = np.arange(sent_m.shape[0], dtype=np.float64) * SENT_S
    return MotionRecording(time_s, position_m + noise, sent_s, sent_m, [(0.0, float(time_s[-1]))])


@dataclass(frozen=True)
class Cascade:
    """An autopilot's position loop: P on position, PI on velocity, with an actuator lag, on a vehicle with drag.

    It is not of second order: the integrator adds a pole and a zero.
    """

    position_gain_per_s: float
    velocity_gain_per_s: float
    integral_gain_per_s2: float
    lag_s: float = 0.15
    delay_s: float = 0.1
    drag_per_s: float = 1.0


def cascaded(
    vehicle: Cascade, seed: int, setpoint_m: Vector, *, wander_m: float = 0.2, velocity_error_m_s: float = 0.15
) -> MotionRecording:
    """Return the log of a cascade that flies on the estimates of a drifting estimator.

    Position and velocity have independent errors, and the vehicle follows them: to the plant they are an input.
    """
    random, step_s = np.random.default_rng(seed), 0.01
    count, late = round(setpoint_m.shape[0] * SENT_S / step_s), round(vehicle.delay_s / step_s)
    keep = np.exp(-step_s / 2.0)  # an estimator's error is smooth
    off_m, off_m_s = (
        lfilter([1.0 - keep], [1.0, -keep], [coloured(random, count, step_s, size, 8.0) for _ in range(2)]).T
        for size in (wander_m, velocity_error_m_s)
    )
    place, speed, push, integral = np.zeros((4, 2))
    path = np.empty((count, 2))
    for at in range(count):
        asked = setpoint_m[max(0, at - late) * setpoint_m.shape[0] // count]
        lacking = vehicle.position_gain_per_s * (asked - place - off_m[at]) - speed - off_m_s[at]
        integral = integral + vehicle.integral_gain_per_s2 * lacking * step_s
        push = push + (vehicle.velocity_gain_per_s * lacking + integral - push) * step_s / vehicle.lag_s
        speed = speed + (push - vehicle.drag_per_s * speed) * step_s
        place = place + speed * step_s
        path[at] = place + off_m[at]
    time_s = np.arange(count) * step_s
    sampled_s = np.arange(float(random.uniform(0.0, 0.2)), time_s[-1], 0.2)
    held = np.floor(sampled_s / SENT_S + 1e-9).astype(int)
    spans_s = [(0.0, float(time_s[-1]))]
    return MotionRecording(time_s[::2], path[::2], sampled_s, setpoint_m[held], spans_s, sampled=True)
