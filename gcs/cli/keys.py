"""`cordon keys`: the keys that authenticate the vehicles, operators and sensors of a team."""

import asyncio
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from getpass import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from cyclopts.validators import Number

from gcs.cli.options import (
    Changes,
    KeyName,
    MissionName,
    bus_mission,
    chosen_vehicle,
    file_or_folder,
    loaded_mission,
    only_file,
)
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from agents.team.participant import Role
    from agents.team.verbs import Verb
    from gcs.keys.approval import ApproverFolder
    from gcs.keys.authority_folder import AuthorityFolder
    from gcs.keys.identity import Identity
    from gcs.keys.roster import Holder, Roster
    from gcs.mission.mission import Mission

Folder = Annotated[Path, Parameter(name="--keys", validator=file_or_folder, help="The folder of the keys.")]
Days = Annotated[float, Parameter(help="Validity in days.", validator=Number(gt=0.0, lte=36500.0))]
DEFAULT_FOLDER = Path("keys")
DEFAULT_DAYS = 30.0


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


def authority_folder(path: Path) -> "AuthorityFolder":
    """Return the folder of an authority; the passphrase of its private key is asked for once, when it is needed."""
    from gcs.keys.authority_folder import AuthorityFolder

    return AuthorityFolder(
        path, cache(lambda: _secret("CORDON_KEYS_PASSPHRASE", f"Passphrase of {path / 'authority'}"))
    )


def _secret(variable: str, question: str, *, is_new: bool = False) -> bytes:
    """Return a secret from an environment variable, the file that one names, or the terminal; raises InputError."""
    from gcs.keys.private_files import read_private

    file = os.environ.get(f"{variable}_FILE")
    if (secret := os.environ.get(variable)) is None and file is not None:
        secret = read_private(Path(file)).decode(errors="surrogateescape").rstrip("\r\n")
    elif secret is None:
        if not sys.stdin.isatty():
            raise InputError([f"{question}: there is no terminal to ask; next: set {variable} or {variable}_FILE"])
        secret = getpass(f"{question}: ")
        if is_new and getpass("Once more: ") != secret:
            raise InputError([f"{question}: the two inputs differ"])
    if not secret:
        raise InputError([f"{question}: it is empty"])
    return secret.encode(errors="surrogateescape")


issue = App(
    name="issue",
    help="Issue keys: a folder to copy to the holder's computer.\n\nExample: cordon keys issue vehicle 3",
)

Name = Annotated[str, Parameter(help="The name: letters, digits, '_', '.' and '-'.")]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class IssueOptions(KeysOptions):
    """Options that all of `cordon keys issue` share."""

    days: Days = DEFAULT_DAYS


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
    """Issue the keys of an operator, who may command the team.

    Example: cordon keys issue operator anna --may hold,resume,land
    """
    return _issue("operator", name, options, _verbs(options.may))


@issue.command
def sensor(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of a sensor, which may send sightings of the target.

    Example: cordon keys issue sensor mast
    """
    return _issue("sensor", name, options)


@issue.command
def positions(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of a program that sends positions of vehicles.

    Example: cordon keys issue positions cameras
    """
    return _issue("positions", name, options)


@issue.command
def observer(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of an observer, who may only watch.

    Example: cordon keys issue observer tower
    """
    return _issue("observer", name, options)


@issue.command
def router(name: Name, /, *, options: IssueOptions = _ISSUE_DEFAULTS) -> Exit:
    """Issue the keys of a router (`cordon router`).

    Example: cordon keys issue router mast
    """
    return _issue("router", name, options)


def _issue(role: "Role", name: str, options: IssueOptions, may: "tuple[Verb, ...] | None" = None) -> Exit:
    from gcs.console.terminal import print_line
    from gcs.keys.roster import expiry, grants

    folder = authority_folder(options.keys)
    holder = folder.issue(role, name, options.days, may)
    if holder.generation > 1:
        print_line(f"{holder.label}: the keys issued before are no longer valid", "yellow")
    print_line(f"{options.keys / holder.label}: issued until {expiry(holder)}; {grants(holder)}")
    print_line(f"next: copy this folder into the keys folder on the computer of {holder.label}")
    print_roster_step([each for each in folder.roster.valid if each != holder], options.keys)
    _print_awaiting(folder, holder.label)
    return Exit.HOLDS


def _print_awaiting(folder: "AuthorityFolder", label: str | None = None) -> None:
    """Print whose kill waits for an approval: all, or one holder."""
    from gcs.console.terminal import print_line

    for holder, request in folder.awaiting:
        if label in (None, holder.label):
            step = f"an approver runs `cordon keys approve {request} APPROVER`, then here: cordon keys admit APPROVAL"
            print_line(f"{holder.label}: its kill has to be approved; next: {step}", "yellow")


def _verbs(may: str | None) -> "tuple[Verb, ...] | None":
    from agents.team.verbs import VERBS

    if may is None:
        return None
    named = [verb.strip() for verb in may.split(",")]
    if unknown := [verb for verb in named if verb not in VERBS]:
        raise InputError([f"--may: unknown verbs: {', '.join(map(repr, unknown))} (verbs: {', '.join(VERBS)})"])
    return tuple(verb for verb in VERBS if verb in named)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MavlinkOptions:
    """Options of `cordon keys issue mavlink`, without the mission."""

    vehicle: Annotated[int | None, Parameter(help="Set up this vehicle only, not all.")] = None


_MAVLINK_DEFAULTS = MavlinkOptions()


@issue.command
def mavlink(mission: MissionName, /, *, options: MavlinkOptions = _MAVLINK_DEFAULTS) -> Exit:
    """Create MAVLink signing keys for a mission's vehicles, and set them up on the connected vehicles.

    A key for each vehicle is written to the mission's link.signing_key_file; existing keys are kept. The key is sent
    to the vehicle unencrypted: connect by USB, or over a private link.

    Example: cordon keys issue mavlink first.toml --vehicle 3
    """
    from gcs.console.terminal import print_line, print_problem
    from gcs.link.signing_keys import issue_keys, leaves_this_computer, set_up_signing, signing_key_path

    flown = loaded_mission(mission)
    path = signing_key_path(flown)
    if path is None:
        raise InputError(
            ['link.signing_key_file: the mission has none; next: [link] signing_key_file = "mavlink.keys"']
        )
    chosen = options.vehicle
    vehicles = flown.vehicles if chosen is None else (chosen_vehicle(flown, chosen, "--vehicle"),)
    for vehicle in vehicles:
        if leaves_this_computer(vehicle.section.url):
            print_line(f"vehicle {vehicle.id}: others may read its key on {vehicle.section.url}; prefer USB", "yellow")
    keys = issue_keys(path, [vehicle.system_id for vehicle in vehicles])
    print_line(
        f"{path}: keys of system id {', '.join(map(str, sorted(keys)))}; keep it secret: it can command the vehicles"
    )
    results = asyncio.run(set_up_signing(vehicles, keys))
    for each in results:
        if each.signs:
            print_line(f"vehicle {each.vehicle_id}: {each.found}")
        else:
            print_problem(f"vehicle {each.vehicle_id}: {each.found}", each.next_step)
    return Exit.HOLDS if all(each.signs for each in results) else Exit.REFUSED


keys = App(
    name="keys",
    help="Create, issue and revoke the keys of a team that flies from several computers.\n\n"
    "Example: cordon keys issue vehicle 3",
)
keys.command(issue)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions(KeysOptions):
    """Options of `cordon keys init`."""

    days: Days = 3650.0
    approver: Annotated[
        tuple[Path, ...],
        Parameter(
            negative="",
            show_default=False,
            validator=only_file,
            help="Public key of an approver, who has to approve each grant of kill; of several, any one.",
        ),
    ] = ()
    token: Annotated[
        str | None,
        Parameter(help="Create the private key on a token: pkcs11:token=LABEL;object=LABEL?module-path=FILE."),
    ] = None


_KEYS_DEFAULTS, _INIT_DEFAULTS = KeysOptions(), InitOptions()


@keys.command
def init(*, options: InitOptions = _INIT_DEFAULTS) -> Exit:
    """Create the certificate authority of a team, which signs all its keys. Keep its folder on this computer.

    Example: cordon keys init --keys keys
    """
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AUTHORITY

    authority_folder(options.keys).init(options.days, options.approver, options.token)
    print_line(f"{options.keys / AUTHORITY}: created; keep it secret: it can issue keys")
    encrypt = "" if options.token else f"cordon keys passphrase --keys {options.keys}; "
    print_line(f"next: {encrypt}cordon keys issue vehicle 1 --keys {options.keys}")
    return Exit.HOLDS


@keys.command
def approver(name: Name, /, *, options: KeysOptions = _KEYS_DEFAULTS) -> Exit:
    """Create the encrypted key pair of an approver, who is not the person with the authority.

    Example: cordon keys approver carol
    """
    from gcs.console.terminal import print_line
    from gcs.keys.certificates import fingerprint_of_pem
    from gcs.keys.private_files import read

    file = _approver(name, options, is_new=True).make()
    print_line(f"{file}: created; its SHA-256: {fingerprint_of_pem(read(file))}")
    print_line(f"next: copy this file to the computer of the authority; there: cordon keys init --approver {file.name}")
    return Exit.HOLDS


def _approver(name: str, options: KeysOptions, *, is_new: bool = False) -> "ApproverFolder":
    from agents.team.participant import is_name
    from gcs.keys.approval import ApproverFolder

    if not is_name(name):
        raise InputError([f"{name}: a name is at most 32 letters, digits, '_', '.' and '-'"])
    path = options.keys / f"approver-{name}"
    variable = "CORDON_KEYS_NEW_PASSPHRASE" if is_new else "CORDON_KEYS_PASSPHRASE"
    return ApproverFolder(path, lambda: _secret(variable, f"Passphrase of {path}", is_new=is_new))


@keys.command
def approve(
    request: Annotated[Path, Parameter(validator=only_file, help="The request: kill-request.json of an operator.")],
    name: Annotated[str, Parameter(help="The approver.")],
    /,
    *,
    options: KeysOptions = _KEYS_DEFAULTS,
) -> Exit:
    """Approve that an operator may kill, and create the key that signs this operator's kills.

    Example: cordon keys approve kill-request.json carol
    """
    from gcs.console.terminal import print_line
    from gcs.keys.approval import APPROVAL_FILE, KILL_KEY_FILE, KillGrant

    asked = KillGrant.read(request)
    print_line(f"{asked.common_name} may kill until {asked.until}, with keys of the authority {asked.authority}")
    folder = _approver(name, options).approve(asked)
    print_line(f"{folder}: approved")
    print_line(f"next: {APPROVAL_FILE} to the computer of the authority; there: cordon keys admit {APPROVAL_FILE}")
    print_line(f"next: {KILL_KEY_FILE} to {asked.operator} only, into the folder operator-{asked.operator}")
    return Exit.HOLDS


@keys.command
def admit(
    approval: Annotated[Path, Parameter(validator=only_file, help="Its kill-approval.json.")],
    /,
    *,
    options: KeysOptions = _KEYS_DEFAULTS,
) -> Exit:
    """Put an approval into the roster.

    Example: cordon keys admit kill-approval.json
    """
    from gcs.console.terminal import print_line

    folder = authority_folder(options.keys)
    print_line(f"{folder.admit(approval).label}: may kill with the approved kill key")
    print_roster_step(folder.roster.valid, options.keys)
    return Exit.HOLDS


@keys.command
def passphrase(*, options: KeysOptions = _KEYS_DEFAULTS) -> Exit:
    """Encrypt the authority's private key with a passphrase, or change it.

    Without a terminal: CORDON_KEYS_PASSPHRASE or CORDON_KEYS_PASSPHRASE_FILE, and CORDON_KEYS_NEW_PASSPHRASE.

    Example: cordon keys passphrase
    """
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AUTHORITY

    authority_folder(options.keys).encrypt(lambda: _secret("CORDON_KEYS_NEW_PASSPHRASE", "New passphrase", is_new=True))
    print_line(f"{options.keys / AUTHORITY}: its private key is encrypted; without the passphrase it is lost")
    return Exit.HOLDS


@keys.command
def renew(
    holder: Annotated[str | None, Parameter(help="The holder, such as vehicle-3. Default: all.")] = None,
    /,
    *,
    options: IssueOptions = _ISSUE_DEFAULTS,
) -> Exit:
    """Renew keys before they expire. The present ones remain valid until then.

    Example: cordon keys renew
    """
    from gcs.console.terminal import print_line
    from gcs.keys.roster import expiry

    folder = authority_folder(options.keys)
    for each in folder.renew(holder, options.days):
        print_line(f"{options.keys / each.label}: renewed until {expiry(each)}; next: copy this folder to its computer")
        _print_awaiting(folder, each.label)
    return Exit.HOLDS


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RevokeOptions(KeysOptions):
    """Options of `cordon keys revoke`."""

    mission: Annotated[str | None, Parameter(help="The mission that flies now: its vehicles take the revocation.")] = (
        None
    )
    changes: Changes = ()
    key: KeyName = None


_REVOKE_DEFAULTS = RevokeOptions()


@keys.command
def revoke(
    holder: Annotated[str, Parameter(help="The holder, such as operator-anna or vehicle-3.")],
    /,
    *,
    options: RevokeOptions = _REVOKE_DEFAULTS,
) -> Exit:
    """Revoke the keys of a holder: in flight with --mission, elsewhere once the roster is copied there.

    Example: cordon keys revoke operator-anna --mission my-mission.toml
    """
    from agents.ports import VehicleRefusedError
    from gcs.console.terminal import print_line, print_problem
    from gcs.keys.team_keys import team_keys

    mission = None if options.mission is None else bus_mission(options.mission, options.changes)
    operator: Identity | None = None
    unsent = "no --mission is given"
    if mission is not None:
        try:  # before: it may revoke itself
            operator = team_keys(mission).identity("operator", options.key)
        except (InputError, VehicleRefusedError) as error:
            unsent = str(error)
    folder = authority_folder(options.keys)
    revoked = folder.revoke(holder)
    print_line(f"{revoked.label}: revoked")
    print_roster_step(folder.roster.valid, options.keys)
    if mission is None or operator is None:
        again = f"cordon keys revoke {holder} --keys {options.keys} --mission MISSION"
        print_problem(f"not sent to a running team: {unsent}", f"`{again}`, with operator keys here")
        return Exit.HOLDS if mission is None else Exit.REFUSED
    if revoked.role == "router":
        print_problem(f"{revoked.label} forwards messages until it ends", "end it, and its computer's link")
    return _send_roster(mission, operator, folder.roster)


def _send_roster(mission: "Mission", operator: "Identity", roster: "Roster") -> Exit:
    from agents.ports import VehicleRefusedError
    from gcs.console.team_bus import send_roster
    from gcs.console.terminal import print_line, print_problem
    from gcs.keys.roster import digest

    network = mission.network.team
    if operator.security is None or digest(operator.security.authority_pem) != roster.authority:
        print_problem(f"not sent: team {network} has keys of another authority, or none", "check --mission and --keys")
        return Exit.REFUSED
    try:
        taken = asyncio.run(send_roster(mission, operator, roster))
    except VehicleRefusedError as refusal:
        print_problem(f"not sent to team {network}: {refusal.reason}", refusal.next_step)
        return Exit.REFUSED
    for vehicle_id in sorted(taken):
        if taken[vehicle_id]:
            print_line(f"vehicle {vehicle_id}: has taken the revocation")
        else:
            print_problem(f"vehicle {vehicle_id}: has not taken the revocation", "try again; copy the roster there")
    if absent := ", ".join(str(each) for each in mission.ids if each not in taken):
        print_line(f"vehicles without the revocation, not on the bus or revoked: {absent}", "yellow")
    return Exit.HOLDS if taken and all(taken.values()) else Exit.REFUSED


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SignOptions(KeysOptions):
    """Options of `cordon keys sign`."""

    yes: Annotated[bool, Parameter(negative="", help="Sign without asking for confirmation.")] = False


_SIGN_DEFAULTS = SignOptions()


@keys.command
def sign(*, options: SignOptions = _SIGN_DEFAULTS) -> Exit:
    """Sign a roster made by an earlier version of cordon, after showing what it grants.

    Example: cordon keys sign
    """
    from gcs.cli.output import confirmed, print_result
    from gcs.console.terminal import print_line, print_problem
    from gcs.keys.roster import ROSTER_FILE, roster_view

    folder = authority_folder(options.keys)
    roster = folder.roster_to_sign
    if roster.signature:
        print_line(f"{options.keys / ROSTER_FILE}: it is signed already")
        return Exit.HOLDS
    print_result(roster_view(roster))
    if not options.yes and not confirmed("Sign this roster? It grants what is listed above."):
        print_problem("not confirmed: the roster was not signed")
        return Exit.REFUSED
    folder.sign(roster)
    print_line(f"{options.keys / ROSTER_FILE}: signed")
    if any(holder.role == "sensor" for holder in roster.valid):
        print_line("sensors may send no positions of vehicles any more: cordon keys issue positions NAME", "yellow")
    print_roster_step(roster.valid, options.keys)
    return Exit.HOLDS


@keys.command
def show(*, options: KeysOptions = _KEYS_DEFAULTS) -> Exit:
    """List the holders of keys, their permissions and expiry dates.

    Example: cordon keys show
    """
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line
    from gcs.keys.roster import expiring, expiry, roster_view

    folder = authority_folder(options.keys)
    roster = folder.roster
    print_result(roster_view(roster))
    if folder.approvers:
        print_line(f"kill needs an approval by an approver with this public key: {' or '.join(folder.approvers)}")
    _print_awaiting(folder)
    for holder in expiring(roster):
        renew = f"cordon keys renew {holder.label} --keys {options.keys}"
        print_line(f"{holder.label}: its keys expire at {expiry(holder, minutes=True)}; next: {renew}", "yellow")
    return Exit.HOLDS
