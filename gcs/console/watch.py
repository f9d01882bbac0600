"""Read-only view of a running team from another terminal: shows the messages on its bus and sends none."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from time import monotonic

from rich.console import Console
from rich.table import Table
from rich.text import Text

from agents.team.messages import BusMessage
from gcs.console.rings import ring_names
from gcs.console.table_view import (
    MISSING,
    MOTION_COLUMNS,
    STYLES,
    Column,
    TableForm,
    TableView,
    empty_table,
    graded,
    motion_cells,
    motion_numbers,
    number,
    plain_row,
    tactic_cell,
    vehicle_cell,
)
from gcs.console.team_bus import WatchedBus
from gcs.console.team_state import TeamMissions, TeamState
from gcs.console.vehicle_view import TeamRow
from gcs.mission.geometry import areas
from gcs.mission.mission import Mission
from gcs.signals import relay

NONE_RECEIVED_AFTER_S = 3.0
PLAIN_INTERVAL_S = 5.0
_VIEW_PERIOD_S = 0.2
_COLUMNS: tuple[Column, ...] = (
    ("", "right"),
    ("tactic", "left"),
    ("age\n[s]", "right"),
    *MOTION_COLUMNS,
    ("x\n[m]", "right"),
    ("y\n[m]", "right"),
    ("r\n[m]", "right"),
    ("ω\n[rad/s]", "right"),
)


class WatchView(TableView):
    """The table of a watched team; without a terminal a line every 5 s, and one for each event."""

    def __init__(self, console: Console, separation_m: float = 0.0) -> None:
        """Prepare to draw on `console`, normally standard error's; distances below `separation_m` are too close."""
        form = TableForm(partial(watch_table, separation_m), watch_line, "VIEW CLOSED", PLAIN_INTERVAL_S)
        super().__init__(console, form)


async def watch_until_ctrl_c(mission: Mission, view: WatchView) -> None:
    """Show the team until SIGINT or SIGTERM."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    relay(lambda: loop.call_soon_threadsafe(stop.set))
    await watch(mission, view, stop)


async def watch(mission: Mission, view: WatchView, stop: asyncio.Event) -> None:
    """Show the team until `stop`.

    Raises InputError if this computer has no keys that may receive, VehicleRefusedError if the team flies another
    mission.
    """
    limits = areas([vehicle.section for vehicle in mission.vehicles], mission.safety)
    team = TeamState(mission.ids, limits, mission.mission_frame(), ring_names(mission))
    missions = TeamMissions(mission)
    began_s = monotonic()

    def take(message: BusMessage) -> None:
        team.receive(message, monotonic())
        missions.receive(message)

    async with WatchedBus(mission, take) as bus:
        while not stop.is_set():
            await bus.follow()
            now_s = monotonic()
            missions.refuse_other()
            for event in team.new_events(now_s):
                view.print_line(event.line, event.severity)
            message = bus.refusal or missions.difference or _message(mission, team, now_s - began_s)
            title = watch_title(mission, now_s - began_s, team.ring_members(now_s))
            view.update(team.rows(now_s, is_over=bool(bus.refusal)), now_s - began_s, message, title=title)
            with suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), _VIEW_PERIOD_S)


def watch_title(mission: Mission, watched_s: float, ring_members: int) -> str:
    """Return the title of a watched team."""
    ring = f"ring {ring_members} of {len(mission.vehicles)}"
    return f"{mission.mission.name}  watched for {watched_s:.0f} s  {ring}"


def watch_table(separation_m: float, rows: Sequence[TeamRow], wide: bool, closed: bool) -> Table:
    """Return the table of a team from its latest messages."""
    table = empty_table(_COLUMNS)
    for row in rows:
        is_dim = (closed or row.is_stale) and not row.is_unaccounted
        table.add_row(*_cells(row, separation_m, wide, closed), style="dim" if is_dim else "")
    return table


def watch_line(rows: Sequence[TeamRow], watched_s: float, message: str) -> str:
    """Return the table as one line of plain text, vehicles separated by bars."""
    return " | ".join([f"watched for {watched_s:.0f} s", *map(_plain, rows), *filter(None, [message])])


def _message(mission: Mission, team: TeamState, watched_s: float) -> str:
    if team.any_received:
        return "read-only; Ctrl-C closes this view"
    silence = f": no vehicle received in {watched_s:.0f} s" if watched_s >= NONE_RECEIVED_AFTER_S else ""
    return f"waiting for team {mission.network.team}{silence}"


def _cells(row: TeamRow, separation_m: float, wide: bool, closed: bool) -> tuple[Text, ...]:
    x_m, y_m, _ = (None,) * 3 if row.position_m is None else row.position_m
    is_silent = row.is_stale and row.age_s is not None and not row.has_ended
    return (
        vehicle_cell(row, closed and not row.is_unaccounted),
        _tactic(row, wide, is_silent),
        graded(row.age_s, ".1f", "alarm" if is_silent else "information"),
        *motion_cells(row, separation_m, wide),
        Text(number(x_m, ".1f")),
        Text(number(y_m, ".1f")),
        Text(number(row.radius_m, ".2f")),
        Text(number(row.angular_rate_rad_s, "+.3f")),
    )


def _tactic(row: TeamRow, wide: bool, is_silent: bool) -> Text:
    if row.has_ended:
        return Text(row.over)
    if is_silent and not row.is_unaccounted:
        return Text("silent", style=STYLES["alarm"])
    return tactic_cell(row, wide)


def _plain(row: TeamRow) -> str:
    if row.position_m is None:
        return f"#{row.vehicle_id} {row.over if row.has_ended else row.note}"
    x_m, y_m, _ = row.position_m
    tactic = MISSING if row.is_unaccounted else row.over if row.has_ended else row.tactic
    return plain_row(row, tactic, f"x={x_m:.1f}m y={y_m:.1f}m", motion_numbers(row))
