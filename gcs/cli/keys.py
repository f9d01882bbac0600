"""`cordon keys`: the keys by which vehicles, operators and sensors of a team know each other."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from cyclopts.validators import Number

from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from agents.team.messages import Verb
    from agents.team.participant import Role
    from gcs.keys.holder import Holder

keys = App(
    name="keys",
    help="Make, issue and revoke the keys of a team that flies from several computers.\n\n"
    "Example: cordon keys issue vehicle 3",
)
issue = App(name="issue", help="Issue keys: a folder to be copied to the holder's computer.")
keys.command(issue)

Folder = Annotated[Path, Parameter(name="--keys", help="The folder of the keys.")]
Days = Annotated[float, Parameter(help="How long they are valid.", validator=Number(gt=0.0, lte=36500.0))]
Name = Annotated[str, Parameter(help="The name: letters, digits, '_', '.' and '-'.")]
DEFAULT_FOLDER = Path("keys")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class KeysOptions:
    """Where the keys are."""

    keys: Folder = DEFAULT_FOLDER


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions(KeysOptions):
    """What `cordon keys init` is given."""

    days: Days = 3650.0


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class IssueOptions(KeysOptions):
    """What all of `cordon keys issue` are given beside a name."""

    days: Days = 365.0


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorOptions(IssueOptions):
    """What `cordon keys issue operator` is given."""

    may: Annotated[
        str | None,
        Parameter(help="The verbs granted, separated by commas, in place of all but kill: kill is granted by name."),
    ] = None


_KEYS_DEFAULTS, _INIT_DEFAULTS = KeysOptions(), InitOptions()
_ISSUE_DEFAULTS, _OPERATOR_DEFAULTS = IssueOptions(), OperatorOptions()


@keys.command
def init(*, options: InitOptions = _INIT_DEFAULTS) -> Exit:
    """Make the authority of a team, which signs all its keys. Its folder `authority` stays on this computer.

    Example: cordon keys init --keys keys
    """
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AUTHORITY, AuthorityFolder

    AuthorityFolder(options.keys).init(options.days)
    print_line(f"{options.keys / AUTHORITY}: made; keep it secret: who has it can issue keys")
    print_line(f"next: cordon keys issue vehicle 1 --keys {options.keys}")
    return Exit.HOLDS


@issue.command
def vehicle(
    vehicle_id: Annotated[str, Parameter(help="Its id in the mission.")], /, *, options: IssueOptions = _ISSUE_DEFAULTS
) -> Exit:
    """Issue the keys of a vehicle, for the computer that runs its agent.

    Example: cordon keys issue vehicle 3
    """

    return _issue("vehicle", vehicle_id, options)


@issue.command
def operator(name: Name, /, *, options: OperatorOptions = _OPERATOR_DEFAULTS) -> Exit:
    """Issue the keys of an operator, who may command the team. Without --may: every verb but kill.

    Example: cordon keys issue operator anna --may hold,resume,land
    """

    return _issue("operator", name, options, _verbs(options.may))


@issue.command
def sensor(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of a sensor outside of the team, which may send sightings of the target.

    Example: cordon keys issue sensor mast
    """

    return _issue("sensor", name, options)


@issue.command
def observer(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of an observer, who may watch the team and send nothing.

    Example: cordon keys issue observer tower
    """

    return _issue("observer", name, options)


@keys.command
def revoke(
    holder: Annotated[str, Parameter(help="The holder, such as operator-anna or vehicle-3.")],
    /,
    *,
    options: KeysOptions = _KEYS_DEFAULTS,
) -> Exit:
    """Revoke the keys of a holder. It takes effect on a computer when the roster has been copied there.

    Example: cordon keys revoke operator-anna
    """
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AuthorityFolder

    folder = AuthorityFolder(options.keys)
    print_line(f"{folder.revoke(holder).label}: revoked")
    _tell_who_needs_the_roster(folder.roster.valid, options.keys)
    return Exit.HOLDS


@keys.command
def show(*, options: KeysOptions = _KEYS_DEFAULTS) -> Exit:
    """Show who has keys, what each may do, and until when.

    Example: cordon keys show
    """
    from gcs.cli.output import print_result
    from gcs.keys.authority_folder import AuthorityFolder
    from gcs.keys.roster_view import roster_view

    print_result(roster_view(AuthorityFolder(options.keys).roster))
    return Exit.HOLDS


def _issue(role: "Role", name: str, options: IssueOptions, may: "tuple[Verb, ...] | None" = None) -> Exit:
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AuthorityFolder
    from gcs.keys.roster_view import expiry, grants

    folder = AuthorityFolder(options.keys)
    holder = folder.issue(role, name, options.days, may)
    if holder.generation > 1:
        print_line(f"{holder.label}: the keys that were issued before no longer count", "yellow")
    print_line(f"{options.keys / holder.label}: issued until {expiry(holder)}; {grants(holder)}")
    print_line(f"next: copy this folder into the folder of keys on the computer of {holder.label}")
    _tell_who_needs_the_roster([each for each in folder.roster.valid if each != holder], options.keys)
    return Exit.HOLDS


def _tell_who_needs_the_roster(holders: "list[Holder] | tuple[Holder, ...]", folder: Path) -> None:
    from gcs.console.terminal import print_line
    from gcs.keys.roster import ROSTER_FILE

    if holders:
        names = ", ".join(holder.label for holder in holders)
        print_line(f"next: copy {folder / ROSTER_FILE} into the folders that were copied already: {names}")


def _verbs(may: str | None) -> "tuple[Verb, ...] | None":
    from gcs.keys.holder import VERBS

    if may is None:
        return None
    named = [verb.strip() for verb in may.split(",")]
    if unknown := [verb for verb in named if verb not in VERBS]:
        raise InputError([f"--may: no verb is {', '.join(map(repr, unknown))} (verbs: {', '.join(VERBS)})"])
    return tuple(verb for verb in VERBS if verb in named)
