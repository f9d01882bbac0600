"""`cordon cot`: a running team on the maps of TAK and others by Cursor-on-Target, and a target from them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.gateway import require_target, run_gateway
from gcs.cli.options import Changes, KeyName, RunningMission, Share, only_file, running_mission
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

if TYPE_CHECKING:
    from gcs.cot.bridge import CotSide
    from gcs.cot.sightings import TrackedTarget
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class CotOptions:
    """Options of `cordon cot`."""

    mission: RunningMission = field(default="case2", kw_only=False)
    to: Annotated[str | None, Parameter(help="Where events go: udp://HOST:PORT, also multicast, tcp:// or tls://.")] = (
        None
    )
    source: Annotated[
        str | None,
        Parameter(
            name="--from",
            help="Where the target's events come from: udp:// on an address of this computer, or tcp:// or tls://; "
            "may be the same stream as --to.",
        ),
    ] = None
    track: Annotated[str | None, Parameter(help="With --from, uid or callsign of the target's events.")] = None
    geoid: Annotated[
        float | None,
        Parameter(
            help="Height of the geoid above the ellipsoid in metres; without it heights are sent as unknown, and "
            "received ones not used.",
            validator=Number(gte=-150.0, lte=150.0),
            allow_leading_hyphen=True,
        ),
    ] = None
    sigma: Annotated[
        float,
        Parameter(
            help="Standard deviation in metres of events without an error.", validator=Number(gt=0.0, lte=1000.0)
        ),
    ] = 2.0
    target: Annotated[str | None, Parameter(help="Name of the target, if the mission has several.")] = None
    importance: Annotated[Share, Parameter(help="Importance of the target, 0 to 1.")] = 0.8
    threat: Annotated[Share, Parameter(help="Threat of the target, 0 to 1.")] = 0.2
    cert: Annotated[
        Path | None,
        Parameter(validator=only_file, help="For tls://, the own certificate: .p12, or .pem with --cert-key."),
    ] = None
    cert_key: Annotated[Path | None, Parameter(validator=only_file, help="The certificate's private key, .pem.")] = None
    authority: Annotated[
        Path | None, Parameter(validator=only_file, help="The authority of the other's certificate, .pem.")
    ] = None
    changes: Changes = ()
    key: KeyName = None


_DEFAULTS = CotOptions()


def cot(options: CotOptions = _DEFAULTS) -> Exit:
    """Send a running team's vehicles, target, rings and alarms as events of Cursor-on-Target, and take a target.

    Ctrl-C ends the gateway, not the flight.

    Example: cordon cot my-mission.toml --to udp://239.2.3.1:6969
    """
    hold_back()
    from gcs.console.terminal import print_line
    from gcs.cot.bridge import CotBridge
    from gcs.cot.transport import require_pytak
    from gcs.keys.team_keys import team_keys

    side = _side(options)
    require_pytak()
    mission = running_mission(options.mission, options.changes)
    tracked = _tracked(options, mission)

    def make() -> CotBridge:
        sensor = team_keys(mission).identity("sensor", options.key)
        return CotBridge(mission, sensor, side, tracked, lambda text: print_line(text, "yellow"))

    return run_gateway(make, f"gateway between team {mission.network.team} and Cursor-on-Target")


def _side(options: CotOptions) -> "CotSide":
    """Return where events go and come from; raises InputError."""
    from gcs.cot.bridge import CotSide
    from gcs.cot.transport import Certificates, CotEndpoint

    if options.to is None and options.source is None:
        raise InputError(
            ["--to: name where events go, such as udp://239.2.3.1:6969, or by --from where they come from"]
        )
    to = None if options.to is None else CotEndpoint.parsed("--to", options.to)
    source = None if options.source is None else CotEndpoint.parsed("--from", options.source)
    secured = any(each is not None and each.scheme == "tls" for each in (to, source))
    for name, path in (("--cert", options.cert), ("--cert-key", options.cert_key), ("--authority", options.authority)):
        if path is not None and not secured:
            raise InputError([f"{name}: {str(path)!r}: only tls:// needs it"])
        if path is not None and not path.exists():
            raise InputError([f"{name}: there is no file {str(path)!r}"])
    if secured and options.cert is None:
        raise InputError(["--cert: tls:// needs a certificate of this program"])
    return CotSide(to, source, Certificates(options.cert, options.cert_key, options.authority), options.geoid)


def _tracked(options: CotOptions, mission: "Mission") -> "TrackedTarget | None":
    """Return which events are of the target; raises InputError."""
    from gcs.cot.sightings import TrackedTarget

    if mission.mission_frame().is_local:
        raise InputError([f"{options.mission}: its frame is local, without latitude and longitude: no event shows it"])
    if (options.track is None) != (options.source is None):
        named = "--track: it needs --from" if options.source is None else "--from: name the target's events by --track"
        raise InputError([named])
    require_target(mission, options.target)
    if options.track is None:
        return None
    return TrackedTarget(
        options.track, options.sigma, options.importance, options.threat, options.geoid, options.target
    )
