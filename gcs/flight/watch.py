"""The live view of a flight: the team's state, its events and late findings, several times a second."""

import asyncio
from collections.abc import Callable, Sequence
from itertools import count
from math import degrees

from rich.text import Text

from agents.outputs import CoreStatus
from agents.shell.computer import short_of
from gcs.console.live import LiveRow
from gcs.flight.team import Member, Team
from gcs.metrics.event_log import event_line
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.senders import impostor, moved
from gcs.preflight.vehicle import clock_lag

FindingsReport = Callable[[Sequence[Finding]], None]

_PERIOD_S = 0.2
_COMPUTER_EVERY = 25


class Watch:
    """Shows a team in its live view. `report` receives findings, `hint` returns what is shown below the table."""

    def __init__(self, team: Team, report: FindingsReport, hint: Callable[[], Text]) -> None:
        self._team = team
        self._report = report
        self._hint = hint
        self._log_fault = ""
        self._links_reported: dict[int, tuple[int, int]] = {}
        self._lags_reported = {member.vehicle.id for member in team.members}  # they share this computer's clock

    async def run(self) -> None:
        """Update the view until cancelled."""
        for update in count():
            if update % _COMPUTER_EVERY == 0:
                self._check_computer()
            self._report_clocks()
            self._report_senders()
            self.show_events()
            self._report_log_fault()
            self._update()
            await asyncio.sleep(_PERIOD_S)

    def show_events(self) -> None:
        """Print the events since the last time."""
        for event in self._team.journal.new_events():
            self._team.view.print_line(event_line(event, self._team.start_s))

    def _update(self) -> None:
        team = self._team
        mission_time_s = 0.0 if team.start_s is None else max(team.clock.now_s() - team.start_s, 0.0)
        message = "holding and landing; Ctrl-C once more: land at once" if team.stop.wanted.is_set() else ""
        rows = [_row(member, team.journal.latest.get(member.vehicle.id)) for member in team.members]
        team.view.update(rows, mission_time_s, message, self._hint())

    def _check_computer(self) -> None:
        log = self._team.plan.log
        short = short_of(None if log is None else log.path)
        for member in self._team.members:
            member.agent.note_computer(short)

    def _report_log_fault(self) -> None:
        fault = self._team.recording.fault
        if fault and not self._log_fault:
            self._log_fault = fault
            self._team.view.print_line(f"the log is incomplete: {fault}; the flight goes on")

    def _report_clocks(self) -> None:
        """Report each other computer once whose clock differs too much from this one's."""
        for member in self._team.members:
            lags_s = member.agent.clock_lags_s
            for peer in lags_s.keys() - self._lags_reported:
                finding = clock_lag(member.vehicle.id, peer, lags_s[peer])
                if finding.grade is not Grade.PASS:
                    self._lags_reported.add(peer)
                    self._report([finding])

    def _report_senders(self) -> None:
        """Report each other sender once that uses a vehicle's system id, and each change of a vehicle's address."""
        for member in self._team.members:
            link, subject = member.link.report, f"vehicle {member.vehicle.id}"
            known = self._links_reported.get(member.vehicle.id, (0, 0))
            self._links_reported[member.vehicle.id] = (len(link.impostors), len(link.moves))
            if len(link.impostors) > known[0]:
                self._report([impostor(subject, link)])
            if len(link.moves) > known[1]:
                self._report([moved(subject, link)])


def _row(member: Member, status: CoreStatus | None) -> LiveRow:
    vehicle = member.link.status
    polar = None if status is None else status.polar
    place = None if status is None else status.place
    return LiveRow(
        vehicle_id=member.vehicle.id,
        tactic="-" if status is None else status.tactic.value,
        mode=vehicle.mode.value,
        connected=vehicle.connected,
        radius_m=None if polar is None else polar.radius_m,
        angular_rate_rad_s=None if polar is None else polar.angular_rate_rad_s,
        spacing_lead_deg=None if place is None or place.lead_rad is None else degrees(place.lead_rad),
        spacing_lag_deg=None if place is None or place.lag_rad is None else degrees(place.lag_rad),
        battery=vehicle.battery,
        note="" if status is None else _remark(status),
    )


def _remark(status: CoreStatus) -> str:
    dropped = f"messages dropped: {status.drops.text()}" if status.drops.total else ""
    return ", ".join(filter(None, [status.alert, status.slowed, dropped]))
