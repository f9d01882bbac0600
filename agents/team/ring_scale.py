"""The ring that a vehicle can fly, as shares of the mission's angular rate and radius."""

import msgspec


class RingScale(msgspec.Struct, frozen=True):
    """A ring as shares of the mission's: of its angular rate, at most 1, and of its radius, at least 1."""

    rate: float = 1.0
    radius: float = 1.0

    def with_(self, other: "RingScale") -> "RingScale":
        """Return the ring that both can fly."""
        return RingScale(min(self.rate, other.rate), max(self.radius, other.radius))


FULL_RING = RingScale()
