"""Read-only view of a running team from another terminal: shows the messages on its bus and sends none."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from time import monotonic

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.table import Table
from rich.text import Text

from agents.team.messages import BusMessage
from gcs.console.live import TACTIC_STYLES, TableView, number
from gcs.console.team_missions import TeamMissions
from gcs.console.team_state import TeamState, WatchRow
from gcs.console.watched_bus import WatchedBus
from gcs.mission.mission import Mission
from gcs.signals import relay

NONE_RECEIVED_AFTER_S = 3.0
PLAIN_INTERVAL_S = 5.0
_VIEW_PERIOD_S = 0.2
_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("", "right"),
    ("tactic", "left"),
    ("age\n[s]", "right"),
    ("x\n[m]", "right"),
    ("y\n[m]", "right"),
    ("height\n[m]", "right"),
    ("r\n[m]", "right"),
    ("ω\n[rad/s]", "right"),
    ("", "left"),
)


class WatchView(TableView[WatchRow]):
    """The table of a watched team; without a terminal a line every 5 s, and one for each event."""

    def __init__(self, console: Console) -> None:
        """Prepare to draw on `console`, normally standard error's."""
        super().__init__(console, watch_table, watch_line, PLAIN_INTERVAL_S)


async def watch_until_ctrl_c(mission: Mission, view: WatchView) -> None:
    """Show the team until SIGINT or SIGTERM."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    relay(lambda: loop.call_soon_threadsafe(stop.set))
    await watch(mission, view, stop)


async def watch(mission: Mission, view: WatchView, stop: asyncio.Event) -> None:
    """Show the team until `stop`.

    Raises InputError when this computer has no keys to listen with, VehicleRefusedError when the team flies another
    mission.
    """
    team, missions, began_s = TeamState(mission.ids), TeamMissions(mission), monotonic()

    def take(message: BusMessage) -> None:
        team.receive(message, monotonic())
        missions.receive(message)

    async with WatchedBus(mission, take) as bus:
        while not stop.is_set():
            await bus.follow()
            now_s = monotonic()
            missions.require_same()
            for event in team.new_events(now_s):
                view.print_line(event.line)
            message = bus.refusal or missions.difference or _message(mission, team, now_s - began_s)
            view.update(team.rows(now_s), now_s - began_s, message)
            with suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), _VIEW_PERIOD_S)


def watch_table(rows: Sequence[WatchRow], watched_s: float, message: str) -> RenderableType:
    """Return the table of a team from its latest messages."""
    table = Table(
        title=f"watched for {watched_s:.0f} s",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        collapse_padding=True,
    )
    for name, justify in _COLUMNS:
        table.add_column(Text(name), justify=justify, no_wrap=True)
    for row in rows:
        table.add_row(*_cells(row), style="dim" if row.silent or row.age_s is None else "")
    return Group(table, Text(message, style="yellow")) if message else table


def watch_line(rows: Sequence[WatchRow], watched_s: float, message: str) -> str:
    """Return the table as one line of plain text, vehicles separated by bars."""
    return " | ".join([f"watched for {watched_s:.0f} s", *map(_plain, rows), *filter(None, [message])])


def _message(mission: Mission, team: TeamState, watched_s: float) -> str:
    if team.any_received:
        return "read-only; Ctrl-C closes this view"
    silence = f": no vehicle received in {watched_s:.0f} s" if watched_s >= NONE_RECEIVED_AFTER_S else ""
    return f"waiting for team {mission.network.team}{silence}"


def _cells(row: WatchRow) -> tuple[Text, ...]:
    x_m, y_m = (None, None) if row.position_m is None else row.position_m
    return (
        Text(str(row.vehicle_id), style="bold"),
        Text(row.tactic, style=TACTIC_STYLES.get(row.tactic, "")),
        Text(number(row.age_s, ".1f"), style="bold red" if row.silent else ""),
        Text(number(x_m, ".1f")),
        Text(number(y_m, ".1f")),
        Text(number(row.altitude_m, ".1f")),
        Text(number(row.radius_m, ".2f")),
        Text(number(row.angular_rate_rad_s, "+.3f")),
        Text(_remark(row), style="yellow"),
    )


def _plain(row: WatchRow) -> str:
    if row.position_m is None:
        return f"#{row.vehicle_id} not received"
    x_m, y_m = row.position_m
    numbers = (
        ("height", row.altitude_m, ".1f", "m"),
        ("r", row.radius_m, ".2f", "m"),
        ("w", row.angular_rate_rad_s, "+.3f", "rad/s"),
    )
    known = [f"{name}={value:{form}}{unit}" for name, value, form, unit in numbers if value is not None]
    parts = [f"#{row.vehicle_id}", row.tactic, f"x={x_m:.1f}m y={y_m:.1f}m", *known, _remark(row)]
    return " ".join(filter(None, parts))


def _remark(row: WatchRow) -> str:
    silent = f"no messages for {row.age_s:.0f} s" if row.silent else "" if row.age_s is not None else "not received"
    dropped = f"dropped: {row.drops.text()}" if row.drops.total else ""
    return ", ".join(filter(None, [silent, row.alert, dropped]))
