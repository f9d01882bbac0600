"""`cordon keys`: the keys that authenticate the vehicles, operators and sensors of a team."""

from dataclasses import dataclass
from typing import Annotated

from cyclopts import App, Parameter

from gcs.cli.keys.issue import issue
from gcs.cli.keys.mavlink import mavlink
from gcs.cli.keys.options import Days, KeysOptions, print_roster_step
from gcs.errors import Exit

keys = App(
    name="keys",
    help="Create, issue and revoke the keys of a team that flies from several computers.\n\n"
    "Example: cordon keys issue vehicle 3",
)
keys.command(issue)
issue.command(mavlink)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class InitOptions(KeysOptions):
    """Options of `cordon keys init`."""

    days: Days = 3650.0


_KEYS_DEFAULTS, _INIT_DEFAULTS = KeysOptions(), InitOptions()


@keys.command
def init(*, options: InitOptions = _INIT_DEFAULTS) -> Exit:
    """Create the certificate authority of a team, which signs all its keys. Keep its folder on this computer.

    Example: cordon keys init --keys keys
    """
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AUTHORITY, AuthorityFolder

    AuthorityFolder(options.keys).init(options.days)
    print_line(f"{options.keys / AUTHORITY}: created; keep it secret: it can issue keys")
    print_line(f"next: cordon keys issue vehicle 1 --keys {options.keys}")
    return Exit.HOLDS


@keys.command
def revoke(
    holder: Annotated[str, Parameter(help="The holder, such as operator-anna or vehicle-3.")],
    /,
    *,
    options: KeysOptions = _KEYS_DEFAULTS,
) -> Exit:
    """Revoke the keys of a holder. The revocation takes effect on a computer once the roster is copied there.

    Example: cordon keys revoke operator-anna
    """
    from gcs.console.terminal import print_line
    from gcs.keys.authority_folder import AuthorityFolder

    folder = AuthorityFolder(options.keys)
    print_line(f"{folder.revoke(holder).label}: revoked")
    print_roster_step(folder.roster.valid, options.keys)
    return Exit.HOLDS


@keys.command
def show(*, options: KeysOptions = _KEYS_DEFAULTS) -> Exit:
    """List the holders of keys, their permissions and expiry dates.

    Example: cordon keys show
    """
    from gcs.cli.output import print_result
    from gcs.keys.authority_folder import AuthorityFolder
    from gcs.keys.roster_view import roster_view

    print_result(roster_view(AuthorityFolder(options.keys).roster))
    return Exit.HOLDS
