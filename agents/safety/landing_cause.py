"""Why a vehicle lands before its mission's end."""

import msgspec


class LandingCause(msgspec.Struct, frozen=True):
    """The cause of an early landing: a condition of the failsafe table, or an operator's command; the other is empty.

    `verb` is the command's, `origin` the operator, empty if unknown.
    """

    condition: str = ""
    verb: str = ""
    origin: str = ""

    @property
    def reason(self) -> str:
        """The condition, or the command and its origin, as text."""
        return self.condition or f"{self.verb} by {self.origin or 'the operator'}"
