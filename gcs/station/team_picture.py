"""Pictures of a flying team for the operator's page, from the messages on its bus: messages in, pictures out."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from math import inf
from statistics import median_high

from msgspec import UNSET
from msgspec.structs import replace

from agents.ring.place import ring_place
from agents.team.messages import (
    MISSION_RING,
    BusMessage,
    MemberState,
    OperatorCommand,
    RingValues,
    TargetPackage,
    VehicleReport,
)
from gcs.console.advice import Severity
from gcs.console.rings import commanded_rings, newest_commanded, ring_names
from gcs.console.team_state import SILENT_AFTER_S, TeamState
from gcs.console.vehicle_view import (
    LINK_CUT,
    SILENT,
    Pair,
    VehicleView,
    may_fly,
    with_alert,
    with_report,
    with_state,
    with_surroundings,
    with_unaccounted,
)
from gcs.metrics.ending import AUTOPILOTS_ALONE, UNACCOUNTED, WATCH_THEM, LostFlight, named
from gcs.mission.geometry import areas
from gcs.mission.mission import Mission
from gcs.station.picture import EventPicture, LostPicture, TargetPicture, TeamPicture
from gcs.station.seen_target import SeenTarget
from gcs.station.traffic import SeenTraffic

VANISHED_AFTER_S = 3.0
"""A team whose messages stop all at once for this long has lost its processes, or this computer its network."""
_PROCESSES_ENDED = "every process that flew them has ended, and no vehicle has reported its landing"
_RECOVERED = "recovered"
_VANISHED = "no vehicle sends messages: their processes have ended, or this computer's network is cut"


@dataclass(slots=True)
class _Received:
    """The newest messages of one vehicle, and when they were received [wall s].

    `sighted_s` is the time of its last sighting of the target of its `ring`, on which its states have been since
    `ring_s`, by its own clock. `estimate` is the newest report of which a state says that it is about the target of
    number `estimated`.
    """

    any_s: float = -inf
    state: MemberState | None = None
    state_s: float = -inf
    report: VehicleReport | None = None
    report_s: float = -inf
    sighted_s: float = -inf
    ring: int = 0
    ring_s: float = -inf
    estimate: VehicleReport | None = None
    estimated: int = 0

    @property
    def ended(self) -> str:
        """How its flight ended, empty before."""
        return "" if self.report is None else self.report.ended

    @property
    def is_link_cut(self) -> bool:
        """Whether its agent reports that the link to its autopilot is cut."""
        return self.report is not None and self.report.is_link_cut

    def received_s(self) -> float:
        """Return the time of its newest state, or of any message if it has sent no state yet."""
        return self.any_s if self.state is None else self.state_s

    @property
    def may_fly(self) -> bool:
        """Whether it is in the air by what it has sent, or may be; in take-off it sends reports only."""
        is_known = self.state is not None or self.report is not None
        return is_known and may_fly(self.report) and not self.ended

    def with_last_position(self, view: VehicleView, now_s: float) -> VehicleView:
        """Return its view with the position in its report, if its flight has ended without an account of it."""
        if self.report is None or self.report.unaccounted_m is None:
            return view
        return replace(view, position_m=self.report.unaccounted_m, age_s=now_s - self.report_s)

    def is_stale(self, now_s: float) -> bool:
        """Return whether its messages have stopped, or its link is cut."""
        return now_s - self.received_s() > SILENT_AFTER_S or self.is_link_cut


class TeamPictures:
    """Makes pictures of a team; times are seconds of one monotonic clock, `unix_offset_s` behind Unix time.

    Successive flights of the same vehicles follow each other in the pictures.
    """

    def __init__(self, mission: Mission, unix_offset_s: float) -> None:
        self._unix_offset_s = unix_offset_s
        self._received = {vehicle_id: _Received() for vehicle_id in mission.ids}
        self._rings = mission.rings
        self._targets = len(mission.targets)
        self._seen_targets = [SeenTarget(mission, each) for each in mission.every_target]
        self._areas = areas([each.section for each in mission.vehicles], mission.safety)
        self._traffic = SeenTraffic()
        self._names = ring_names(mission)
        self._state = TeamState(mission.ids, rings=self._names)
        self._numbers = count(1)
        self._events: list[tuple[int | None, str, Severity]] = []
        self._lost: tuple[float, LostFlight] | None = None
        self._unaccounted: set[int] = set()
        self._recovered: set[int] = set()
        self._time_s: float | None = None
        self._remaining_s: float | None = None

    def receive(self, message: BusMessage, now_s: float) -> None:
        """Take a message of the bus."""
        received = None if isinstance(message, OperatorCommand) else self._received.get(message.sender)
        # A state may arrive after the report that the flight has ended: it does not revive the vehicle.
        if received is None or not (received.ended and isinstance(message, MemberState)):
            self._state.receive(message, now_s)
        if received is None:
            return
        if self._lost is not None and now_s - self._lost[0] > SILENT_AFTER_S:  # later than messages in transit
            self._lost = None
        received.any_s = now_s
        match message:
            case MemberState():
                received.state, received.state_s = message, now_s
                self._follow_ring(received, message)
                self._traffic.take(message, now_s)
                sighted = [each.time_s for each in message.sightings if self._is_of_ring(each, received.ring)]
                received.sighted_s = max(sighted, default=received.sighted_s)
            case VehicleReport():
                self._events += [(message.sender, *event) for event in _news(received.report, message)]
                if received.report is not None and _is_of_another_flight(received.report, message):
                    received.state, received.state_s, received.sighted_s = None, -inf, -inf
                    received.ring, received.ring_s, received.estimate = 0, -inf, None
                    self._recovered.discard(message.sender)
                    for seen in self._seen_targets:
                        seen.forget()
                if message.ended:
                    self._state.end(message.sender)
                received.report, received.report_s = message, now_s
            case _:
                pass

    def _follow_ring(self, received: _Received, state: MemberState) -> None:
        """Take the ring that a state names: a vehicle without one keeps to the target of its last, at first of ring 0.

        A report between the states of two rings may be about the target of either.
        """
        ring = None if state.choice is None else state.choice.ring
        if ring is not None and ring != received.ring and ring < len(self._rings):
            received.ring, received.ring_s, received.sighted_s = ring, state.time_s, -inf
        report = received.report
        if report is not None and received.ring_s <= report.time_s <= state.time_s:
            received.estimate = report
            received.estimated = self._rings[received.ring].target if self._rings else 0

    def _is_of_ring(self, sighting: TargetPackage, ring: int) -> bool:
        return self._targets == 0 or sighting.target in (None, self._rings[ring].target if self._rings else 0)

    def lose(self, flight: LostFlight, now_s: float) -> None:
        """Take the end of the flying process, from its supervisor."""
        self._lost = now_s, flight
        self._events.append((None, f"{named(flight.vehicles)} {UNACCOUNTED}: {flight.reason}", "alarm"))

    def recover(self, vehicle_id: int) -> None:
        """Take an operator's confirmation that a vehicle was recovered; no effect on one that is accounted for."""
        if vehicle_id in self._unaccounted:
            self._unaccounted.discard(vehicle_id)
            self._recovered.add(vehicle_id)
            self._events.append((vehicle_id, f"{_RECOVERED}, as an operator confirmed on the page", "information"))

    def new_events(self, now_s: float) -> list[EventPicture]:
        """Return the events since the last call."""
        events: list[tuple[int | None, str, Severity]] = [
            (each.vehicle_id, each.text, each.severity) for each in self._state.new_events(now_s)
        ]
        events += self._events
        self._events = []
        return [
            EventPicture(
                next(self._numbers), self._time_s, now_s + self._unix_offset_s, level, text, vehicle_id=vehicle_id
            )
            for vehicle_id, text, level in events
        ]

    def picture(self, now_s: float, link: str = "", stood_s: float = 0.0, *, is_over: bool = False) -> TeamPicture:
        """Return the team at `now_s`; `link` is the fault of the link to it, and no flight runs if it `is_over`.

        Nothing could come from the team for `stood_s` since its last message: see `Standstill`. While vehicles that
        have not ended send messages, a flight runs: their presence may be noticed later than these.
        """
        is_over = is_over and all(each.ended or now_s - each.any_s > SILENT_AFTER_S for each in self._received.values())
        self._update_time(now_s)
        lost = self._lost_picture(now_s, stood_s, is_over=is_over)
        self._unaccounted = self._found_unaccounted(is_gone=is_over or lost is not None)
        unaccounted = tuple(i for i in self._received if i in self._unaccounted)
        lost = replace(lost, vehicles=unaccounted) if lost is not None and unaccounted else None
        is_over = is_over and lost is None
        places_m = {
            i: each.state.position_m
            for i, each in self._received.items()
            if each.state and (not each.ended or i in self._unaccounted)
        }
        vehicles = tuple(self._vehicle(i, now_s, places_m, is_over=is_over) for i in self._received)
        targets = tuple(
            seen.picture(self._target(now_s, number), now_s) for number, seen in enumerate(self._seen_targets)
        )
        rings = tuple(map(self._commanded_ring, range(max(len(self._rings), 1))))
        return TeamPicture(
            self._time_s,
            now_s + self._unix_offset_s,
            vehicles,
            None if self._rings else targets[0],
            sum(each.radius_m is not None and not each.is_stale and not each.has_ended for each in vehicles),
            self._ending(is_over=is_over),
            (link if lost is None else "") or self._silence(now_s, is_over=is_over),
            self._remaining_s,
            lost,
            None if self._rings else rings[0],
            targets if self._rings else UNSET,
            rings if self._rings else UNSET,
            self._traffic.pictures(now_s) or UNSET,
        )

    def _commanded_ring(self, number: int) -> RingValues | None:
        """Return the values of a ring that operators commanded last, None for nothing."""
        flying = (each.state for each in self._received.values() if each.state and not each.ended)
        commanded = newest_commanded(map(commanded_rings, flying), number)
        return None if commanded == MISSION_RING else RingValues(*(value for value, _ in commanded.dated))

    def _found_unaccounted(self, *, is_gone: bool) -> set[int]:
        """Return the vehicles that nothing accounts for: by their reports, or because the flight `is_gone`."""
        found = {
            i
            for i, each in self._received.items()
            if (each.report is not None and each.report.unaccounted_m is not None) or (is_gone and each.may_fly)
        }
        if self._lost is not None:
            found |= self._received.keys() & self._lost[1].vehicles
        return found - self._recovered

    def _lost_picture(self, now_s: float, stood_s: float, *, is_over: bool) -> LostPicture | None:
        """Return the loss that the supervisor reported, or that of a whole team whose messages stopped in flight."""
        if self._lost is not None:
            flight = self._lost[1]
            reason, alone, advice = flight.reason, flight.autopilots, flight.next_step
            return LostPicture(reason, flight.vehicles, flight.ended_s, alone, advice, is_over)
        received = [each for each in self._received.values() if each.any_s > -inf]
        if any(each.ended for each in received) or not any(each.may_fly for each in received):
            return None
        since_s = max(each.any_s for each in received)
        if now_s - since_s - stood_s <= (SILENT_AFTER_S if is_over else VANISHED_AFTER_S):
            return None
        reason = _PROCESSES_ENDED if is_over else _VANISHED
        alone = AUTOPILOTS_ALONE if is_over else f"if their processes have ended, {AUTOPILOTS_ALONE}"
        return LostPicture(reason, (), since_s + self._unix_offset_s, alone, WATCH_THEM, is_over)

    def _update_time(self, now_s: float) -> None:
        """Update the mission's time from the vehicles' messages; without messages and after the end it stands still."""
        live = [each for each in self._received.values() if now_s - each.any_s <= SILENT_AFTER_S and not each.ended]
        times_s = [max(_time_s(each.state), _time_s(each.report)) for each in live if each.state or each.report]
        missions = [each.report for each in live if each.report is not None and each.report.start_s is not None]
        if live and not missions:
            self._time_s = self._remaining_s = None
        elif live:
            start_s = median_high(each.start_s or 0.0 for each in missions)
            duration_s = median_high(each.duration_s for each in missions)
            since_s = median_high(times_s) - start_s
            self._time_s = since_s if since_s >= 0.0 else None
            self._remaining_s = min(max(duration_s - since_s, 0.0), duration_s)

    def _vehicle(self, vehicle_id: int, now_s: float, places_m: Mapping[int, Pair], *, is_over: bool) -> VehicleView:
        received = self._received[vehicle_id]
        if received.any_s == -inf:
            return VehicleView(vehicle_id)
        ending = _RECOVERED if vehicle_id in self._recovered else received.ended
        is_stale, has_ended = received.is_stale(now_s), bool(ending) or is_over
        own_alert = "" if received.state is None else received.state.alert
        lost = (LINK_CUT if received.is_link_cut else SILENT) if is_stale else ""
        view = VehicleView(
            vehicle_id,
            age_s=now_s - received.received_s(),
            is_stale=is_stale,
            has_ended=has_ended,
            lead_rad=self._lead_rad(vehicle_id, now_s),
            ending=ending,
        )
        if received.state is not None:
            view = with_state(view, received.state, self._names)
        if received.report is not None:
            since_s = now_s - max(received.state_s, received.report_s)
            clock_s = max(_time_s(received.state), received.report.time_s) + since_s
            view = with_report(view, received.report, now_s - received.report_s, clock_s)
        view = with_surroundings(view, places_m, self._areas)
        if vehicle_id in self._unaccounted:
            return with_unaccounted(received.with_last_position(view, now_s))
        return with_alert(view, "" if has_ended else own_alert or lost, is_lost=bool(lost))

    def _lead_rad(self, vehicle_id: int, now_s: float) -> float | None:
        """Return the angle to the vehicle ahead on the ring, None for a vehicle off the ring or alone on it."""
        bearings_rad = {
            i: each.state.angle.bearing_rad
            for i, each in self._received.items()
            if each.state is not None
            and each.state.angle is not None
            and each.ring == self._received[vehicle_id].ring
            and not each.is_stale(now_s)
            and not each.ended
        }
        own_rad = bearings_rad.pop(vehicle_id, None)
        return None if own_rad is None else ring_place(own_rad, list(bearings_rad.values())).lead_rad

    def _target(self, now_s: float, number: int) -> TargetPicture | None:
        """Return the estimate of a target with the newest sighting among the vehicles that send messages.

        With several rings only a vehicle whose ring is about it has one.
        """
        sending = [each for each in self._received.values() if now_s - each.any_s <= SILENT_AFTER_S and not each.ended]
        if self._rings:
            known = [_estimate(each, each.estimate) for each in sending if each.estimated == number]
        else:
            known = [_estimate(each, each.report) for each in sending]
        return min((each for each in known if each is not None), key=lambda each: each.sighting_age_s, default=None)

    def _ending(self, *, is_over: bool) -> str:
        received = {i: each.ended for i, each in self._received.items() if each.any_s > -inf}
        # One that is unaccounted for may not have reported its end, or that report was lost.
        over = any(received.values()) and all(ended or i in self._unaccounted for i, ended in received.items())
        if not received or not (is_over or over):
            return ""
        by_end: dict[str, list[str]] = {}
        for vehicle_id, ended in received.items():
            if vehicle_id in self._unaccounted:
                end = UNACCOUNTED
            elif vehicle_id in self._recovered:
                end = _RECOVERED
            else:
                end = ended or "silent at the end: find and inspect it"
            by_end.setdefault(end, []).append(str(vehicle_id))
        if len(by_end) == 1:
            return next(iter(by_end))
        return "; ".join(f"{', '.join(ids)} {ended}" for ended, ids in by_end.items())

    def _silence(self, now_s: float, *, is_over: bool) -> str:
        """Return for how long no flying vehicle has sent a message; empty while one does."""
        flying = [each.any_s for each in self._received.values() if each.any_s > -inf and not each.ended]
        if is_over or not flying or now_s - max(flying) <= SILENT_AFTER_S:
            return ""
        return f"no message from any vehicle for {now_s - max(flying):.0f} s"


def _news(before: VehicleReport | None, report: VehicleReport) -> list[tuple[str, Severity]]:
    """Return the events from the changes between two reports."""
    if before is None or _is_of_another_flight(before, report):
        return []
    news: list[tuple[str, Severity]] = []
    if report.mode != before.mode:
        news.append((f"mode {before.mode} -> {report.mode}", "information"))
    if report.is_link_cut != before.is_link_cut:
        news.append(("link to its autopilot cut", "alarm") if report.is_link_cut else ("link restored", "information"))
    return news


def _is_of_another_flight(before: VehicleReport, report: VehicleReport) -> bool:
    """Return whether a vehicle flies another flight: the last one ended, or had begun at another time."""
    return not report.ended and (bool(before.ended) or before.start_s not in (None, report.start_s))


def _time_s(message: MemberState | VehicleReport | None) -> float:
    return -inf if message is None else message.time_s


def _estimate(received: _Received, report: VehicleReport | None) -> TargetPicture | None:
    """Return the target as a vehicle reported it, extrapolated to the vehicle's newest state."""
    if report is None or report.target is None:
        return None
    target, time_s = report.target, max(_time_s(received.state), report.time_s)
    later_s, (x, y), (x_rate, y_rate) = time_s - report.time_s, target.position_m, target.velocity_m_s
    sighted_s = max(report.time_s - target.sighting_age_s, received.sighted_s)
    return TargetPicture(
        (x + x_rate * later_s, y + y_rate * later_s),
        target.velocity_m_s,
        target.covariance_m2,
        max(time_s - sighted_s, 0.0),
    )
