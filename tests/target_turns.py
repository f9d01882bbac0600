"""Flights about a target that turns: `python -m tests.target_turns 10`.

Each seed flies case3-turns as it is - 2 m/s, turns of 90 degrees, stops, outliers, late sightings, a silent sensor -
and again with nobody seeing the target for 20 s. Exit code 1 when a flight misses a limit.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from agents.outputs import TickOutput
from agents.tactics import Tactic
from estimation.state import POSITION
from gcs.mission import Mission
from gcs.simulated import simulated_vehicles
from sitl.simulation import NetworkModel, simulate
from tests.conftest import MISSIONS
from tests.mission_text import content, parsed

MISSION = (MISSIONS / "case3-turns.toml").read_text(encoding="utf-8")
SETTLED_S, CATCH_UP_S = 25.0, 15.0
BLIND_FROM_S, BLIND_S, PATIENCE_S = 100.0, 20.0, 30.0
TARGET_ERROR_MAX_M, BROKEN_MAX, JUMP_MAX_M = 0.5, 0.25, 0.5


@dataclass(frozen=True)
class Turns:
    """What a flight shows: the target's error rms and the worst share of R by which the ring is broken, both while
    somebody sees the target; and the farthest that a setpoint moves from one tick to the next, from when nobody sees
    it on until some time after they see it again.
    """

    target_error_rms_m: float
    broken: float
    jump_m: float

    def within_limits(self, *, blind: bool) -> bool:
        """Return whether the figures are as promised."""
        if blind:
            return self.jump_m <= JUMP_MAX_M
        return self.target_error_rms_m <= TARGET_ERROR_MAX_M and self.broken <= BROKEN_MAX


def mission(*, blind: bool) -> Mission:
    """Return case3-turns; when `blind`, nobody sees the target for a while, and everybody waits for it."""
    text = content(MISSION)
    if blind:
        nobody = [[BLIND_FROM_S, BLIND_FROM_S + BLIND_S]]
        text["target"]["sensor"]["blind_s"] = nobody
        for vehicle in text["vehicles"]:
            vehicle.pop("sensor", None)
        text["target_filter"] = {"stale_after_s": PATIENCE_S}
    return parsed(text)


def flown(seed: int, *, blind: bool, duration_s: float | None = None) -> Turns:
    """Fly once, and look at it against the truth."""
    flight = mission(blind=blind)
    rate_hz, duration_s, count = flight.mission.rate_hz, duration_s or flight.mission.duration_s, len(flight.vehicles)
    believed_m = np.full((round(duration_s * rate_hz) + 1, count, 2), np.nan)
    setpoint_m = np.full_like(believed_m, np.nan)

    def observe(tick: int, vehicle: int, output: TickOutput) -> None:
        if output.status.target is not None and output.status.tactic is Tactic.ENCIRCLE:
            believed_m[tick, vehicle] = output.status.target[POSITION]
        if output.setpoint is not None:
            setpoint_m[tick, vehicle] = output.setpoint.position_m[:2]

    network = NetworkModel(flight.network.range_m, 0.05, 0.05)
    vehicles = simulated_vehicles(flight, seed)
    truth = simulate(
        vehicles,
        network,
        rate_hz=rate_hz,
        duration_s=duration_s,
        seed=seed,
        observe=observe,
        progress=lambda _: None,
    )
    target_m = np.array([flight.target.motion.position_m(time_s) for time_s in truth.time_s.tolist()])[:, None]
    seen = truth.time_s > SETTLED_S
    if blind:
        seen &= truth.time_s < BLIND_FROM_S
    error_m = np.linalg.norm(believed_m - target_m, axis=2)[seen]
    radius_m = np.linalg.norm(truth.motion[:, :, POSITION] - target_m, axis=2)[seen]
    about = (truth.time_s > BLIND_FROM_S + 1.0) & (truth.time_s < BLIND_FROM_S + BLIND_S + CATCH_UP_S)
    jumps_m = np.linalg.norm(np.diff(setpoint_m, axis=0), axis=2)[about[1:]]
    ring_m = flight.encirclement.radius_m
    return Turns(
        float(np.sqrt(np.mean(error_m**2))), float(np.abs(radius_m - ring_m).max()) / ring_m, float(jumps_m.max())
    )


def _both(seed: int) -> tuple[int, Turns, Turns]:
    return seed, flown(seed, blind=False), flown(seed, blind=True)


def main(arguments: list[str]) -> int:
    """Fly so many seeds and print the figures of each."""
    failures = 0
    with ProcessPoolExecutor(2) as pool:
        for seed, seen, blind in pool.map(_both, range(int(arguments[0]) if arguments else 5)):
            print(
                f"seed {seed}: target error {seen.target_error_rms_m:.3f} m rms, ring broken by {seen.broken:.1%} at "
                f"most; blackout: setpoints move by {blind.jump_m:.2f} m a tick at most",
                flush=True,
            )
            failures += not (seen.within_limits(blind=False) and blind.within_limits(blind=True))
    print(f"{failures} beyond the limits: {TARGET_ERROR_MAX_M} m, {BROKEN_MAX:.0%} of R, {JUMP_MAX_M} m")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
