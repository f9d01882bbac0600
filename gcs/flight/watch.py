"""The live view of a flight: the team's state, its events and late findings, several times a second."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from itertools import count

from msgspec import UNSET, UnsetType
from rich.text import Text

from agents.outputs import CoreStatus
from agents.shell.computer import short_of
from agents.shell.reporter import estimator_words
from agents.team.messages import LINK_SILENT_S
from estimation.state import Telemetry
from gcs.console.advice import event_severity
from gcs.console.live import flight_title
from gcs.console.rings import flown_ring, ring_names
from gcs.console.table_view import NO_HINT
from gcs.console.vehicle_view import TeamRow, with_alert, with_outlook, with_surroundings, with_unaccounted
from gcs.flight.team import DISARMED, FlightTeam, Member
from gcs.metrics.ending import Unaccounted
from gcs.metrics.journal import event_line
from gcs.mission.geometry import Place, areas
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.senders import impostor, moved
from gcs.preflight.vehicle import clock_lag

FindingsReport = Callable[[Sequence[Finding]], None]

_PERIOD_S = 0.2
_COMPUTER_EVERY = 25


class Watch:
    """Shows a team in its live view. `report` receives findings, `hint` returns the text below the table."""

    def __init__(self, team: FlightTeam, report: FindingsReport, hint: Callable[[], Text]) -> None:
        self._team = team
        self._report = report
        self._hint = hint
        mission = team.plan.mission
        self._areas = areas([vehicle.section for vehicle in mission.vehicles], mission.safety)
        self._frame = mission.mission_frame()
        self._rings = ring_names(mission)
        self._log_fault = ""
        self._rates = {member.vehicle.section.url: member.link.pace.rates for member in team.members}
        self._links_reported: dict[int, tuple[int, int]] = {}
        self._lags_reported = {member.vehicle.id for member in team.members}  # they share this computer's clock

    async def run(self) -> None:
        """Update the view until cancelled."""
        for update in count():
            if update % _COMPUTER_EVERY == 0:
                self._check_computer()
            self._report_clocks()
            self._report_senders()
            self._report_rates()
            self._show_events()
            self._report_log_fault()
            self._update(self._hint())
            await asyncio.sleep(_PERIOD_S)

    def end(self) -> None:
        """Show how every vehicle ended, and the last events."""
        self._show_events()
        self._update(NO_HINT)

    def _show_events(self) -> None:
        for event in self._team.journal.new_events():
            line = event_line(event, self._team.start_s)
            self._team.view.print_line(line, event_severity(event))

    def _update(self, hint: Text) -> None:
        team, mission = self._team, self._team.plan.mission
        time_s = None if team.start_s is None else max(team.clock.now_s() - team.start_s, 0.0)
        if not team.view.shows_at(time_s or 0.0):
            return  # building the rows of a large team takes a noticeable part of a tick
        places_m = _places_m(team)
        rows = [self._row(member, team.newest.get(member.vehicle.id), places_m) for member in team.members]
        flying = any(not row.ending and not row.is_unaccounted for row in rows)
        message = "holding, then landing; Ctrl-C again: land at once" if flying and team.stop.wanted.is_set() else ""
        name = f"BENCH {mission.mission.name}" if team.plan.bench else mission.mission.name
        title = flight_title(name, time_s, team.plan.duration_s, _ring_members(team), len(mission.vehicles))
        team.view.update(rows, time_s or 0.0, message, hint, title)

    def _check_computer(self) -> None:
        log = self._team.plan.log
        short = short_of(None if log is None else log.path)
        for member in self._team.members:
            member.agent.note_computer(short)

    def _report_log_fault(self) -> None:
        fault = self._team.recording.fault
        if fault and not self._log_fault:
            self._log_fault = fault
            self._team.view.print_line(f"the log is incomplete: {fault}; the flight continues")

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
            link = member.link.report
            known = self._links_reported.get(member.vehicle.id, (0, 0))
            self._links_reported[member.vehicle.id] = (len(link.impostors), len(link.moves))
            if len(link.impostors) > known[0]:
                self._report([impostor(member.vehicle.id, link)])
            if len(link.moves) > known[1]:
                self._report([moved(member.vehicle.id, link)])

    def _report_rates(self) -> None:
        """Print each change of a connection's rates."""
        for member in self._team.members:
            url, rates = member.vehicle.section.url, member.link.pace.rates
            if rates != self._rates[url]:
                self._team.view.print_line(f"{url}: {rates.changed_from(self._rates[url])}")
                self._rates[url] = rates

    def _row(self, member: Member, status: CoreStatus | None, places_m: Mapping[int, Place]) -> TeamRow:
        vehicle, vehicle_id, last = member.link.status, member.vehicle.id, member.agent.unaccounted
        ending = "" if last is not None else member.ending
        polar, place = (None, None) if status is None else (status.polar, status.place)
        motion = member.link.motion
        alert = "" if status is None or ending else status.alert
        link_age_s = None if motion is None else self._age_s(motion)
        row = TeamRow(
            vehicle_id,
            is_stale=link_age_s is None or link_age_s > LINK_SILENT_S,
            has_ended=bool(ending),
            tactic="" if status is None else status.tactic.value,
            mode=vehicle.mode.value if vehicle.connected else "",
            position_m=None if motion is None else motion.position_m,
            velocity_m_s=None if motion is None else motion.velocity_m_s[:2],
            autopilot=vehicle,
            estimator=estimator_words(vehicle),
            link_age_s=link_age_s,
            radius_m=None if polar is None else polar.radius_m,
            angular_rate_rad_s=None if polar is None else polar.angular_rate_rad_s,
            lead_rad=None if place is None else place.lead_rad,
            ending=ending,
            in_reserve=member.agent.in_reserve,
            ring=_ring(status, self._rings),
            note="" if status is None or ending else _remark(status),
            gps_threat=vehicle.gps_threat.value,
            lag_rad=None if place is None else place.lag_rad,
            round_trip_s=None if vehicle.round_trip_s is None else vehicle.round_trip_s / self._team.clock.time_scale,
        )
        row = with_surroundings(row, places_m, self._areas)
        if last is not None:
            return with_unaccounted(row, Unaccounted.of(vehicle_id, last, self._frame))
        row = with_outlook(row, None if ending else member.agent.outlook, self._team.clock.now_s())
        return with_alert(row, alert)

    def _age_s(self, motion: Telemetry) -> float:
        """Return the age of a sample [wall s]."""
        clock = self._team.clock
        return max(clock.now_s() - motion.time_s, 0.0) / clock.time_scale


def _ring(status: CoreStatus | None, rings: Sequence[str]) -> str | UnsetType:
    if not rings:
        return UNSET
    return "" if status is None else flown_ring(status.tactic, status.ring, rings)


def _places_m(team: FlightTeam) -> dict[int, Place]:
    """Return the positions of all vehicles in flight: from their autopilots, or from messages to their peers."""
    places_m = {peer.sender: peer.position_m for status in team.newest.values() for peer in status.peers}
    for member in team.members:
        if member.ending == DISARMED:
            places_m.pop(member.vehicle.id, None)
        elif member.link.motion is not None:
            x, y, _ = member.link.motion.position_m
            places_m[member.vehicle.id] = (x, y)
    return places_m


def _ring_members(team: FlightTeam) -> int:
    """Return how many vehicles fly on the ring, by their own status or by messages to their peers."""
    flying = [member.vehicle.id for member in team.members if not member.ending]
    statuses = [team.newest[each] for each in flying if each in team.newest]
    here = {status.vehicle_id for status in statuses if status.place is not None}
    received = {peer.sender for status in statuses for peer in status.peers if peer.angle is not None}
    return len(here | received.difference(member.vehicle.id for member in team.members))


def _remark(status: CoreStatus) -> str:
    dropped = f"messages dropped: {status.drops.text()}" if status.drops.total else ""
    return ", ".join(filter(None, [status.slowed, dropped]))
