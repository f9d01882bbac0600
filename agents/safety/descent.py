"""Why a vehicle comes down before its mission's end."""

import msgspec


class Descent(msgspec.Struct, frozen=True):
    """The condition of the failsafe table that brought a vehicle down, or the operator's command; the other is empty.

    `verb` is the command's, `origin` is who gave it, empty if that is not known any more.
    """

    condition: str = ""
    verb: str = ""
    origin: str = ""

    @property
    def reason(self) -> str:
        """The condition, or the command and who gave it, in words."""
        return self.condition or f"{self.verb} by {self.origin or 'the operator'}"
