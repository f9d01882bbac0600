"""Options that the verbs of `cordon keys` share, and the message of those that change the roster."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

if TYPE_CHECKING:
    from gcs.keys.holder import Holder

Folder = Annotated[Path, Parameter(name="--keys", help="The folder of the keys.")]
Days = Annotated[float, Parameter(help="Validity in days.", validator=Number(gt=0.0, lte=36500.0))]
DEFAULT_FOLDER = Path("keys")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class KeysOptions:
    """The option that all verbs of `cordon keys` have."""

    keys: Folder = DEFAULT_FOLDER


def print_roster_step(holders: "Sequence[Holder]", folder: Path) -> None:
    """Print which folders need the changed roster."""
    from gcs.console.terminal import print_line
    from gcs.keys.roster import ROSTER_FILE

    if holders:
        names = ", ".join(holder.label for holder in holders)
        print_line(f"next: copy {folder / ROSTER_FILE} into the key folders on other computers: {names}")
