"""`cordon keys issue`: keys for vehicles, operators, sensors, observers and routers."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from gcs.cli.keys.options import Days, KeysOptions, print_roster_step
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from agents.team.messages import Verb
    from agents.team.participant import Role

issue = App(
    name="issue",
    help="Issue keys: a folder to copy to the holder's computer.\n\nExample: cordon keys issue vehicle 3",
)

Name = Annotated[str, Parameter(help="The name: letters, digits, '_', '.' and '-'.")]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class IssueOptions(KeysOptions):
    """Options that all of `cordon keys issue` share."""

    days: Days = 365.0


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorOptions(IssueOptions):
    """Options of `cordon keys issue operator`."""

    may: Annotated[
        str | None,
        Parameter(help="Verbs that the operator may command, separated by commas. Default: all but kill."),
    ] = None


_ISSUE_DEFAULTS, _OPERATOR_DEFAULTS = IssueOptions(), OperatorOptions()


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
    """Issue the keys of an operator, who may command the team. Without --may: all verbs but kill.

    Example: cordon keys issue operator anna --may hold,resume,land
    """
    return _issue("operator", name, options, _verbs(options.may))


@issue.command
def sensor(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of a sensor outside the team, which may send sightings of the target.

    Example: cordon keys issue sensor mast
    """
    return _issue("sensor", name, options)


@issue.command
def observer(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of an observer, who may watch the team but send nothing.

    Example: cordon keys issue observer tower
    """
    return _issue("observer", name, options)


@issue.command
def router(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of a router (`cordon router`), which authenticates senders for the whole team.

    Example: cordon keys issue router mast
    """
    return _issue("router", name, options)


def _issue(role: "Role", name: str, options: IssueOptions, may: "tuple[Verb, ...] | None" = None) -> Exit:
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AuthorityFolder
    from gcs.keys.roster_view import expiry, grants

    folder = AuthorityFolder(options.keys)
    holder = folder.issue(role, name, options.days, may)
    if holder.generation > 1:
        print_line(f"{holder.label}: the keys issued before are no longer valid", "yellow")
    print_line(f"{options.keys / holder.label}: issued until {expiry(holder)}; {grants(holder)}")
    print_line(f"next: copy this folder into the keys folder on the computer of {holder.label}")
    print_roster_step([each for each in folder.roster.valid if each != holder], options.keys)
    return Exit.HOLDS


def _verbs(may: str | None) -> "tuple[Verb, ...] | None":
    from gcs.keys.holder import VERBS

    if may is None:
        return None
    named = [verb.strip() for verb in may.split(",")]
    if unknown := [verb for verb in named if verb not in VERBS]:
        raise InputError([f"--may: unknown verbs: {', '.join(map(repr, unknown))} (verbs: {', '.join(VERBS)})"])
    return tuple(verb for verb in VERBS if verb in named)
