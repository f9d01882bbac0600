"""Fly about a target that turns and is not seen for some time, and measure the jumps of ring and setpoints.

Each seed flies case3-turns as it is - 2 m/s, turns of 90 degrees, stops, outliers, late sightings, a silent sensor -
and twice with a blackout of 20 s: once with a longer `stale_after_s`, so that the vehicles wait for the target, and
once with the mission's, so that they hold and an operator commands resume. Exit code 1 if a flight exceeds a limit.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from enum import Enum

import numpy as np

from agents.inputs import Message
from agents.outputs import TickOutput
from agents.tactics import Tactic
from agents.team.messages import OperatorCommand
from estimation.state import POSITION
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel
from tests.experiments.arguments import seeded_parser
from tests.support.mission_text import content, parsed
from tests.support.observed_flight import observed
from tests.support.paths import MISSIONS

MISSION = (MISSIONS / "case3-turns.toml").read_text(encoding="utf-8")
SETTLED_S = 25.0
BLIND_FROM_S, BLIND_S, PATIENCE_S, RESUMED_S = 100.0, 20.0, 30.0, 125.0
TARGET_ERROR_MAX_M, BROKEN_MAX, JUMP_MAX_M = 0.5, 0.25, 0.5


class Flight(Enum):
    """The variants: the mission as it is, with a blackout that is waited for, and with one that makes vehicles hold."""

    SEEN = "seen"
    AWAITED = "awaited"
    HELD = "held"


@dataclass(frozen=True)
class Turns:
    """The results of a flight: the target's rms error and the worst radius error as a share of R, both until the
    blackout; the largest step of a setpoint between ticks, from the blackout - without one, once settled - to the end;
    and the sequence of the first vehicle's tactics.
    """

    target_error_rms_m: float
    broken: float
    jump_m: float
    tactics: tuple[Tactic, ...]

    @property
    def within_limits(self) -> bool:
        """Whether the figures are within the limits."""
        return self.target_error_rms_m <= TARGET_ERROR_MAX_M and self.broken <= BROKEN_MAX and self.jump_m <= JUMP_MAX_M


def mission(flight: Flight) -> Mission:
    """Return case3-turns, except for `SEEN` with a blackout."""
    text = content(MISSION)
    if flight is not Flight.SEEN:
        nobody = [[BLIND_FROM_S, BLIND_FROM_S + BLIND_S]]
        text["target"]["sensor"]["blind_s"] = nobody
        for vehicle in text["vehicles"]:
            vehicle.pop("sensor", None)
    if flight is Flight.AWAITED:
        text["target"]["stale_after_s"] = PATIENCE_S
    return parsed(text)


def flown(seed: int, flight: Flight, duration_s: float | None = None) -> Turns:
    """Fly once, for as long as the mission unless told otherwise, and compare with the truth."""
    turning = mission(flight)
    rate_hz, count = turning.mission.rate_hz, len(turning.vehicles)
    duration_s = duration_s or turning.mission.duration_s
    believed_m = np.full((round(duration_s * rate_hz) + 1, count, 2), np.nan)
    setpoint_m = np.full_like(believed_m, np.nan)
    tactics: list[Tactic] = []
    vehicles = simulated_vehicles(turning, seed)

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        if output.status.target is not None and output.status.tactic is Tactic.ENCIRCLE:
            believed_m[tick, vehicle] = output.status.target[POSITION]
        if output.setpoint is not None:
            setpoint_m[tick, vehicle] = output.setpoint.position_m[:2]
        if vehicle == 0 and tactics[-1:] != [output.status.tactic]:
            tactics.append(output.status.tactic)
        if flight is Flight.HELD and tick == round(RESUMED_S * rate_hz):
            resume = OperatorCommand(RESUMED_S, "resume", None, "tower", 1)
            vehicles[vehicle].core.take(Message(RESUMED_S, resume))

    network = NetworkModel(turning.range_m, 0.05, 0.05)
    truth = observed(turning, seed, observe, duration_s=duration_s, vehicles=vehicles, network=network)
    target_m = np.array([turning.target.motion.position_m(time_s) for time_s in truth.time_s.tolist()])[:, None]
    seen, about = truth.time_s > SETTLED_S, truth.time_s > SETTLED_S
    if flight is not Flight.SEEN:
        seen &= truth.time_s < BLIND_FROM_S
        about = truth.time_s >= BLIND_FROM_S
    error_m = np.linalg.norm(believed_m - target_m, axis=2)[seen]
    radius_m = np.linalg.norm(truth.motion[:, :, POSITION] - target_m, axis=2)[seen]
    jumps_m = np.linalg.norm(np.diff(setpoint_m, axis=0), axis=2)[about[1:]]
    ring_m = turning.encirclement.radius_m
    return Turns(
        float(np.sqrt(np.mean(error_m**2))),
        float(np.abs(radius_m - ring_m).max()) / ring_m,
        float(jumps_m.max()),
        tuple(tactics),
    )


def _all(seed: int) -> dict[Flight, Turns]:
    return {flight: flown(seed, flight) for flight in Flight}


def main(count: int, first: int) -> int:
    """Fly a number of seeds, from the seed `first` on, and print the figures of each."""
    failures = 0
    with ProcessPoolExecutor(2) as pool:
        seeds = range(first, first + count)
        for seed, turns in zip(seeds, pool.map(_all, seeds), strict=True):
            for flight, shown in turns.items():
                print(
                    f"seed {seed}, {flight.value}: target error {shown.target_error_rms_m:.3f} m rms, ring broken by "
                    f"{shown.broken:.1%} at most; setpoints move by {shown.jump_m:.3f} m a tick at most",
                    flush=True,
                )
                failures += not shown.within_limits
    print(f"{failures} beyond the limits: {TARGET_ERROR_MAX_M} m, {BROKEN_MAX:.0%} of R, {JUMP_MAX_M} m")
    return int(failures > 0)


if __name__ == "__main__":
    given = seeded_parser("target_turns", __doc__, 5).parse_args()
    sys.exit(main(given.count, given.first))
