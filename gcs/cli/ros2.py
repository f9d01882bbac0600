"""`cordon ros2`: a bridge between a running team and the nodes of ROS 2."""

import os
from dataclasses import dataclass, field
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.gateway import require_target, run_gateway
from gcs.cli.options import Changes, KeyName, RunningMission, Share, running_mission
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

DOMAIN_VARIABLE = "ROS_DOMAIN_ID"


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Options:
    """Options of `cordon ros2`."""

    mission: RunningMission = field(default="case2", kw_only=False)
    router: Annotated[str, Parameter(help="Endpoint of the router of ROS, rmw_zenohd.")] = "tcp/localhost:7447"
    domain: Annotated[
        int | None,
        Parameter(help=f"Domain of ROS, instead of {DOMAIN_VARIABLE} or 0.", validator=Number(gte=0, lte=232)),
    ] = None
    sightings: Annotated[str, Parameter(help="Topic of the target's poses.")] = "/target/pose"
    frame: Annotated[str, Parameter(help="frame_id of all poses: about the mission's origin, x east, y north.")] = "map"
    sigma: Annotated[
        float,
        Parameter(
            help="Standard deviation in metres of poses without a covariance.", validator=Number(gt=0.0, lte=1000.0)
        ),
    ] = 2.0
    target: Annotated[str | None, Parameter(help="Name of the target, if the mission has several.")] = None
    importance: Annotated[Share, Parameter(help="Importance of the target, 0 to 1.")] = 0.8
    threat: Annotated[Share, Parameter(help="Threat of the target, 0 to 1.")] = 0.2
    changes: Changes = ()
    key: KeyName = None


_DEFAULTS = Ros2Options()


def ros2(options: Ros2Options = _DEFAULTS) -> Exit:
    """Send poses that a node of ROS 2 publishes as sightings to a running team, and the vehicles' poses to ROS.

    ROS has to use rmw_zenoh. Ctrl-C ends the bridge, not the flight.

    Example: cordon ros2 my-mission.toml --sightings /tracker/pose
    """
    hold_back()
    from gcs.console.terminal import print_line
    from gcs.keys.team_keys import team_keys
    from gcs.ros2.bridge import Bridge, RosSide
    from gcs.ros2.messages import require_rosbags
    from gcs.ros2.rmw_zenoh import topic_of
    from gcs.ros2.sightings import SightingDefaults

    require_rosbags()
    side = RosSide(_endpoint(options.router), _domain(options.domain), topic_of("--sightings", options.sightings))
    mission = running_mission(options.mission, options.changes)
    require_target(mission, options.target)
    defaults = SightingDefaults(options.frame, options.sigma, options.importance, options.threat, options.target)

    def make() -> Bridge:
        sensor = team_keys(mission).identity("sensor", options.key)
        return Bridge(mission, sensor, side, defaults, lambda text: print_line(text, "yellow"))

    return run_gateway(make, f"bridge between team {mission.network.team} and ROS domain {side.domain}")


def _domain(given: int | None) -> int:
    """Return the domain of ROS; raises InputError for an environment variable that is none."""
    text = os.environ.get(DOMAIN_VARIABLE, "")
    if given is not None or not text:
        return given or 0
    if not (text.isascii() and text.isdecimal() and int(text) <= 232):
        raise InputError([f"{DOMAIN_VARIABLE}: {text!r} is no domain of ROS, 0 to 232"])
    return int(text)


def _endpoint(text: str) -> str:
    """Return an endpoint of Zenoh; raises InputError."""
    protocol, _, address = text.partition("/")
    if protocol not in ("tcp", "udp", "tls", "quic", "ws") or not address.rpartition(":")[2].isdecimal():
        raise InputError([f"--router: {text!r} is no endpoint such as tcp/192.168.1.5:7447"])
    return text
