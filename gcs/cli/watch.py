"""`cordon watch`: the live view of a running team."""

import asyncio
from dataclasses import dataclass

from cyclopts import Parameter

from gcs.cli.options import Changes, RunningMission, running_mission
from gcs.errors import Exit
from gcs.signals import hold_back


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WatchOptions:
    """Options of `cordon watch`."""

    mission: RunningMission = "case2"
    changes: Changes = ()


_DEFAULTS = WatchOptions()


def watch(*, options: WatchOptions = _DEFAULTS) -> Exit:
    """Watch a running team from another terminal. Read-only; Ctrl-C ends the view, not the flight.

    Example: cordon watch --mission px4-trio
    """
    hold_back()
    from agents.ports import VehicleRefusedError
    from gcs.console.terminal import STDERR, print_problem
    from gcs.console.watch import WatchView, watch_until_ctrl_c

    mission = running_mission(options.mission, options.changes)
    try:
        with WatchView(STDERR, mission.safety.separation_m) as view:
            asyncio.run(watch_until_ctrl_c(mission, view))
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    return Exit.HOLDS
