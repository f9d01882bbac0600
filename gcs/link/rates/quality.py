"""The quality of a connection: counts of received and lost frames, and its radio's report."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Traffic:
    """Counts of one connection since it was opened.

    `missed` are frames from its vehicles that never arrived, by the gaps in their sequence numbers. `buffer_free` is
    the free share of the radio's transmit buffer by the newest RADIO_STATUS, None where no radio reports.
    """

    up_bytes: int = 0
    down_bytes: int = 0
    received: int = 0
    missed: int = 0
    buffer_free: float | None = None

    def lost_share(self, before: "Traffic") -> float:
        """Return the share of frames that were lost since an earlier count."""
        received, missed = self.received - before.received, self.missed - before.missed
        return missed / (received + missed) if missed > 0 else 0.0
