"""The targets of a mission of several targets or rings, as its records number them."""

from gcs.mission.mission import Mission, TargetSection


def targets_of(mission: Mission) -> tuple[TargetSection, ...]:
    """Return the targets of a mission of several targets or rings; empty for one of one ring about one target."""
    several = len(mission.targets) > 1 or len(mission.rings) > 1
    return mission.every_target if several else ()


def ring_targets_of(mission: Mission) -> tuple[int, ...]:
    """Return the number of each ring's target among `targets_of` a mission; empty without these."""
    targets = targets_of(mission)
    return (tuple(each.target for each in mission.rings) or (targets.index(mission.target),)) if targets else ()
