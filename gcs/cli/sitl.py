"""`cordon sitl`: a mission's stub vehicles, without agents."""

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.options import Changes, MissionName, Speed, loaded_mission
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sitl.server.server import StubConfig


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SitlOptions:
    """Options of `cordon sitl`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    speed: Speed = None
    lockstep: Annotated[
        bool,
        Parameter(
            negative="",
            help="Let the simulated time wait for the flights of this computer that use these vehicles, which join its "
            "clock by themselves. Other MAVLink clients see the vehicles as without it.",
        ),
    ] = False
    radio: Annotated[
        str | None,
        Parameter(help="Put an emulated radio between the vehicles and their urls; see `cordon relay`."),
    ] = None


def sitl(options: SitlOptions) -> Exit:
    """Run only a mission's stub vehicles, for `cordon fly`, QGroundControl or any MAVLink client. Ctrl-C ends it.

    Example: cordon sitl case3-turns --speed 5

    Example: cordon sitl px4-trio --radio baud=57600,latency_ms=60,loss=0.02
    """
    hold_back()
    from contextlib import ExitStack

    from agents.ports import VehicleRefusedError
    from gcs.console.terminal import print_problem
    from gcs.flight.request import require_governed
    from gcs.flight.stubs import serve_until_ctrl_c, served_clock, stub_configs
    from gcs.link.ports import stub_claims
    from gcs.radio.serving import free_ports, mission_radio, radio_spec, running_beside

    mission, speed = loaded_mission(options.mission, options.changes), options.speed or 1.0
    require_governed(options.speed, only_stubs=False, advice="give it to the flight that joins with --lockstep")
    if options.lockstep and options.radio is not None:
        raise InputError(["--lockstep: an emulated radio (--radio) takes wall time, and cannot wait"])
    spec = None if options.radio is None else radio_spec(options.radio)
    ports = None if spec is None else free_ports(mission)
    configs = stub_configs(mission, ports)
    try:
        with ExitStack() as stack:
            ports_served = sorted({config.client_port for config in configs})
            stack.enter_context(stub_claims(ports_served))
            if spec is not None and ports is not None:
                stack.enter_context(running_beside(mission_radio(spec, mission, ports)))
            _announce(configs, speed)
            make_clock = stack.enter_context(served_clock(speed, ports_served, lockstep=options.lockstep))
            asyncio.run(serve_until_ctrl_c(configs, make_clock))
    except VehicleRefusedError as refusal:
        print_problem(f"the stub vehicles did not start: {refusal.reason}", refusal.next_step)
        return Exit.REFUSED
    except OSError as error:
        print_problem(f"the stub vehicles did not start: {error}", "check whether another program uses their ports")
        return Exit.REFUSED
    return Exit.HOLDS


def _announce(configs: "Sequence[StubConfig]", speed: float) -> None:
    """Print where the vehicles send to, and how fast their time runs."""
    from gcs.console.terminal import STDERR

    for config in configs:
        place = f"{config.client_host}:{config.client_port}"
        STDERR.print(f"vehicle {config.vehicle_id}: MAVLink to udp {place}", highlight=False)
    STDERR.print(f"simulated time runs at {speed:g} times the wall clock; Ctrl-C ends it", highlight=False)
