"""`cordon sitl`: a mission's stub vehicles alone."""

import asyncio
from dataclasses import dataclass, field

from cyclopts import Parameter

from gcs.cli.options import MissionName, Speed, loaded_mission
from gcs.errors import Exit
from gcs.signals import hold_back


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SitlOptions:
    """What `cordon sitl` is given."""

    mission: MissionName = field(kw_only=False)
    speed: Speed = None


def sitl(options: SitlOptions) -> Exit:
    """Serve a mission's stub vehicles alone, for `cordon fly`, QGroundControl or any MAVLink client; Ctrl-C ends it.

    Example: cordon sitl case2 --speed 5
    """
    hold_back()
    from agents.ports import VehicleRefusedError
    from gcs.console.terminal import STDERR, print_problem
    from gcs.flight.stubs import serve_until_ctrl_c, stub_configs
    from gcs.link.ports.claims import stub_claims

    configs, speed = stub_configs(loaded_mission(options.mission)), options.speed or 1.0
    try:
        with stub_claims([config.client_port for config in configs]):
            for config in configs:
                place = f"{config.client_host}:{config.client_port}"
                STDERR.print(f"vehicle {config.vehicle_id}: MAVLink to udp {place}", highlight=False)
            STDERR.print(f"simulated time runs at {speed:g} times the wall clock; Ctrl-C ends it", highlight=False)
            asyncio.run(serve_until_ctrl_c(configs, speed))
    except VehicleRefusedError as refusal:
        print_problem(f"the stub vehicles did not start: {refusal.reason}", refusal.next_step)
        return Exit.REFUSED
    except OSError as error:
        print_problem(f"the stub vehicles did not start: {error}", "check whether another program uses their ports")
        return Exit.REFUSED
    return Exit.HOLDS
