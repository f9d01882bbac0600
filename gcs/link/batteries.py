"""The batteries of one vehicle by their ids: those that it flies with, and the lowest of them.

A battery that stops being reported, or whose values become unknown, keeps its last values for `KEPT_S`: one lost or
empty report does not end a failsafe, and a battery that is gone does not stay for ever.
"""

from dataclasses import dataclass

KEPT_S = 30.0
"""How long the last values of a battery count beside newer reports; the last ones of all batteries stay."""


@dataclass(frozen=True, slots=True)
class BatteryReport:
    """One report of a battery: its charge as a fraction, and its estimated time until it is empty; None is unknown.

    The vehicle `flies` with it unless it is for avionics or payload.
    """

    number: int
    charge: float | None
    endurance_s: float | None = None
    flies: bool = True


class Batteries:
    """The newest values of each battery."""

    def __init__(self) -> None:
        self.newest: dict[int, BatteryReport] = {}
        """The newest report of each battery."""
        self._reported_s: dict[int, float] = {}
        self._charges: dict[int, tuple[float, float]] = {}
        self._endurances_s: dict[int, tuple[float, float]] = {}

    def take(self, battery: BatteryReport, now_s: float) -> None:
        """Take a report that arrives now."""
        number = battery.number
        self.newest[number], self._reported_s[number] = battery, now_s
        for values, value in ((self._charges, battery.charge), (self._endurances_s, battery.endurance_s)):
            if value is not None and battery.flies:
                values[number] = value, now_s
            for each in [each for each, (_, at_s) in values.items() if now_s - at_s > KEPT_S]:
                del values[each]
        for each in [each for each, at_s in self._reported_s.items() if now_s - at_s > KEPT_S]:
            del self.newest[each], self._reported_s[each]

    @property
    def charge(self) -> float | None:
        """The lowest charge of the batteries that the vehicle flies with, None if all are unknown."""
        return min((value for value, _ in self._charges.values()), default=None)

    @property
    def endurance_s(self) -> float | None:
        """The lowest estimated time until one of them is empty, None if all are unknown."""
        return min((value for value, _ in self._endurances_s.values()), default=None)
