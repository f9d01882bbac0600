"""The numbers of peers' messages as machine numbers, which compiled code reads ten times as fast as fields of structs.

They are made once for a message, by the first vehicle of a process that reads them, and shared by all.
"""

from typing import Final


class StateNumbers:
    """The numbers of a member's state (`agents.team.messages.MemberState`), in its units and frame.

    `on_ring` is the number of the ring about which it flies, -1 for none, and `place` its place there; `evades` and
    `is_off_ring` are by its tactic (`agents/tactics.py`). A state that `is_bare` has no aircraft, and no values that an
    operator commanded. `goes_on` is whether its task goes on from an earlier state, that of `compared_id`, 0 for none
    (`Team.waits`).
    """

    def __init__(
        self,
        state_id: int,
        sender: int,
        time_s: float,
        position_m: tuple[float, float],
        velocity_m_s: tuple[float, float],
        aim_m: tuple[float, float],
        altitude_m: float,
        position_sigma_m: float,
        on_ring: int,
        place: "PlaceNumbers | None",
        *,
        evades: bool,
        is_off_ring: bool,
        has_sightings: bool,
        is_bare: bool,
    ) -> None:
        """Take the numbers, and an id that no other state of the process has."""
        self.state_id: Final = state_id
        self.sender: Final = sender
        self.time_s: Final = time_s
        self.position_m: Final = position_m
        self.velocity_m_s: Final = velocity_m_s
        self.aim_m: Final = aim_m
        self.altitude_m: Final = altitude_m
        self.position_sigma_m: Final = position_sigma_m
        self.on_ring: Final = on_ring
        self.place: Final = place
        self.evades: Final = evades
        self.is_off_ring: Final = is_off_ring
        self.has_sightings: Final = has_sightings
        self.is_bare: Final = is_bare
        self.compared_id = 0
        self.goes_on = False


class PlaceNumbers:
    """The numbers of a vehicle's place on the ring (`agents.team.messages.NeighbourAngle`), in its units and frame.

    `reference_rad` is 0 where it `has_reference` not.
    """

    def __init__(
        self,
        sender: int,
        time_s: float,
        bearing_rad: float,
        angular_rate_rad_s: float,
        radius_m: float,
        shares: tuple[float, float],
        reference_rad: float | None,
        reference_rate_rad_s: float,
        references: int,
    ) -> None:
        """Take the numbers; `shares` are those of the ring's rate and of its radius."""
        self.sender: Final = sender
        self.time_s: Final = time_s
        self.bearing_rad: Final = bearing_rad
        self.angular_rate_rad_s: Final = angular_rate_rad_s
        self.radius_m: Final = radius_m
        self.shares: Final = shares
        self.has_reference: Final = reference_rad is not None
        self.reference_rad: Final = 0.0 if reference_rad is None else reference_rad
        self.reference_rate_rad_s: Final = reference_rate_rad_s
        self.references: Final = references

    def bearing_at_rad(self, at_s: float) -> float:
        """Return the bearing at a time, extrapolated at the published rate - (25), (26)."""
        return self.bearing_rad + self.angular_rate_rad_s * (at_s - self.time_s)
