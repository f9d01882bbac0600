"""The rings of a mission as operators see them: the ring that a vehicle has chosen, and what they commanded of each."""

from collections.abc import Iterable, Sequence

from agents.tactics import Tactic
from agents.team.messages import CommandedRing, MemberState, newest_ring
from gcs.mission.mission import Mission

CommandedRings = tuple[CommandedRing, ...]
"""The values of all rings that operators commanded, in the order of the mission's; empty for none."""


def ring_names(mission: Mission) -> tuple[str, ...]:
    """Return the names of a mission's rings, none if it has one."""
    return tuple(each.name for each in mission.rings)


def ring_text(number: int | None, names: Sequence[str]) -> str:
    """Return the name of the ring of a number, empty for None and beyond the mission's rings."""
    return names[number] if number is not None and number < len(names) else ""


def chosen_ring(state: MemberState, names: Sequence[str]) -> str:
    """Return the name of the ring that a vehicle is on or flies to, empty if there is none."""
    return ring_text(None if state.choice is None else state.choice.ring, names)


_ON_RINGS = (Tactic.ENCIRCLE, Tactic.TRANSIT)


def flown_ring(tactic: Tactic, number: int, names: Sequence[str]) -> str:
    """Return the name of the ring that a vehicle flies on, or flies to, by its own decision; empty for none."""
    return ring_text(number, names) if tactic in _ON_RINGS else ""


def commanded_rings(state: MemberState) -> CommandedRings:
    """Return the commanded values of the rings in a vehicle's state, in missions of one ring and of several."""
    if state.choice is not None:
        return state.choice.commanded
    return () if state.ring is None else (state.ring,)


def newest_commanded(rings: Iterable[CommandedRings], number: int) -> CommandedRing:
    """Return the newest values of the ring of a number among those in the states of a team."""
    return newest_ring(each[number] for each in rings if number < len(each))
