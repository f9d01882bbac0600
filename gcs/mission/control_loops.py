"""Checks of a mission's control loops: stability by eigenvalues, and rates that match."""

from collections.abc import Iterator, Sequence
from math import floor

from estimation.plant.model import Plant
from estimation.settings import Settings
from gcs.errors import Fault
from gcs.mission.links import LinkSection
from gcs.mission.mission import Mission, MissionSection
from gcs.mission.stability import ClosedLoop, loops

_NEUTRAL = 1e-6
"""A marginally stable loop is accepted: a spacing gain of 0 is allowed."""
_ADVICE = {
    "formation": "raise increment_weight or lower position_weight of [tuning.formation], or raise mission.rate_hz",
    "encirclement": "weights, gains and prediction_step_s of [tuning.encirclement] and mission.rate_hz depend on each "
    "other: start from their defaults",
}


def unstable_loops(mission: Mission) -> Iterator[Fault]:
    """Return the worst unstable loop of each section on every plant of the mission, with its margin.

    If all are stable: a spacing gain that moves the references faster than the vehicles can follow.
    """
    checked: set[Plant] = set()
    for index, vehicle in enumerate(mission.vehicles):
        if vehicle.plant in checked:
            continue
        checked.add(vehicle.plant)
        every = list(loops(mission.agent_config(vehicle)))
        unstable = list(_unstable(every, index))
        yield from unstable or _not_followed(every, index, mission)


def _unstable(every: Sequence[ClosedLoop], index: int) -> Iterator[Fault]:
    for section, advice in _ADVICE.items():
        worst = min((loop for loop in every if loop.section == section), key=lambda loop: loop.margin)
        if worst.margin < -_NEUTRAL:
            yield Fault(
                section,
                f"{worst.name} is unstable with the plant of vehicles[{index}]: its largest eigenvalue "
                f"has modulus {worst.modulus:.3f}, a margin of {worst.margin:+.3f} to 1; {advice}",
            )


def _not_followed(every: Sequence[ClosedLoop], index: int, mission: Mission) -> Iterator[Fault]:
    gain_per_s = mission.encirclement.spacing_gain_per_s
    followed_per_s = min(loop.decay_per_s(mission.mission.rate_hz) for loop in every if loop.of_bearing)
    if len(mission.vehicles) > 1 and gain_per_s > followed_per_s > _NEUTRAL:
        yield Fault(
            "tuning.encirclement.spacing_gain_per_s",
            f"{gain_per_s} 1/s is faster than vehicles[{index}] follows its "
            f"reference with this plant; at most {floor(followed_per_s * 100.0) / 100.0} 1/s",
        )


def kept_up(mission: Settings | None, link: Settings | None) -> Iterator[Fault]:
    """Check that the link's setpoint rate does not exceed the rate of the control loop."""
    if not (isinstance(mission, MissionSection) and isinstance(link, LinkSection)):
        return
    if link.setpoint_rate_hz is not None and link.setpoint_rate_hz > mission.rate_hz:
        yield Fault(
            "link.setpoint_rate_hz",
            f"{link.setpoint_rate_hz} Hz is more than mission.rate_hz = {mission.rate_hz} Hz: "
            "the loop computes no more setpoints; leave this key out to send all of them",
        )
