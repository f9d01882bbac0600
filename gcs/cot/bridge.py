"""The gateway: a running team as events of Cursor-on-Target, and a target's events as sightings for the team.

On the team's bus it is a sensor with the keys of one.
"""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import atan2, cos, degrees, hypot, sin, sqrt
from time import monotonic, time

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage, MemberState, TargetPackage, newest_ring
from agents.team.perception import TOPIC
from agents.team.text import printable
from gcs.console.advice import severity
from gcs.console.command_client import TeamClock
from gcs.console.rings import commanded_rings
from gcs.console.team_bus import guest_bus
from gcs.console.team_state import TeamMissions
from gcs.cot.events import alarm_event, ring_event, target_event, vehicle_event
from gcs.cot.sightings import EventRefusedError, EventSightings, TrackedTarget
from gcs.cot.transport import Certificates, CotConnection, CotEndpoint
from gcs.errors import InputError
from gcs.keys.identity import Identity
from gcs.mission.mission import Mission

PERIOD_S = 1.0
"""Wall time between two events of an object."""
_SILENT_S = 2.0
"""A vehicle is not sent after this wall time without a message."""
_POLL_S = 0.1


@dataclass(frozen=True, slots=True)
class CotSide:
    """Where events go `to` and come `from` (both None: not at all), and the files for TLS.

    `geoid_m` is the height of the geoid above the ellipsoid at the mission, None if it is not known.
    """

    to: CotEndpoint | None
    source: CotEndpoint | None
    certificates: Certificates
    geoid_m: float | None


class CotBridge:
    """Carries a team's state to Cursor-on-Target, and the events of a target to the team."""

    def __init__(
        self,
        mission: Mission,
        sensor: Identity,
        side: CotSide,
        target: TrackedTarget | None,
        report: Callable[[str], None],
    ) -> None:
        """Take the sensor to send sightings as; `report` is called with each new reason of a refusal.

        Raises InputError for a mission in a local frame.
        """
        if mission.mission_frame().is_local:
            raise InputError(["cot: the mission has a local frame, without latitude and longitude"])
        self._report = report
        self._bus = guest_bus(mission, sensor)
        self._clock, self._missions = TeamClock(), TeamMissions(mission)
        self._team = TeamEvents(mission, side.geoid_m)
        self._out = None if side.to is None else CotConnection(side.to, side.certificates, sends=True)
        self._in = self._out
        if side.source is not None and (side.source != side.to or side.source.scheme == "udp"):
            self._in = CotConnection(side.source, side.certificates, sends=False)
        self.sightings = None if target is None else EventSightings(mission, target)
        """The sightings taken and refused so far; None if none are taken."""
        self.sent = 0
        """How many events were sent."""

    async def run(self, stop: asyncio.Event) -> None:
        """Carry events until `stop`.

        Raises VehicleRefusedError if an address or the team's bus cannot be joined or a stream ends, or the team flies
        another mission; InputError for certificates that cannot be read.
        """
        connections = {each for each in (self._out, self._in) if each is not None}
        tasks: list[asyncio.Task[None]] = []
        try:
            for each in connections:
                await each.open()
            await self._bus.open(self._take, lambda *_: None, lambda *_: None)
            if self._out is not None:
                tasks.append(asyncio.create_task(self._send(self._out)))
            tasks += [asyncio.create_task(self._receive(each)) for each in connections if each.receives]
            tasks.append(asyncio.create_task(self._watch(stop)))
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()
            for task in tasks:
                with suppress(asyncio.CancelledError, VehicleRefusedError):
                    await task
            await self._bus.close()
            for each in connections:
                each.close()

    @property
    def summary(self) -> str:
        """What it has carried, and what it refused, by reason."""
        sent = f"{self.sent} events sent"
        if self._out is not None and self._out.unsent:
            sent += f", {self._out.unsent} that nobody received"
        if self.sightings is None:
            return sent
        refused = self.sightings.refused
        reasons = ", ".join(f"{count}: {reason.value}" for reason, count in sorted(refused.items(), key=str))
        taken = f"{self.sightings.taken} sightings to the team, {self.sightings.others} events of others"
        return f"{sent}, {taken}, {refused.total()} events refused{f' ({reasons})' if reasons else ''}"

    async def _watch(self, stop: asyncio.Event) -> None:
        reported = ""
        while not stop.is_set():
            self._missions.refuse_other()
            if (difference := self._missions.difference) and difference != reported:
                reported = difference
                self._report(difference)
            with suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), _POLL_S)

    async def _send(self, connection: CotConnection) -> None:
        while True:
            for event in self._team.events(monotonic(), time()):
                await connection.send(event)
                self.sent += 1
            await asyncio.sleep(PERIOD_S)

    async def _receive(self, connection: CotConnection) -> None:
        while True:
            event = await connection.receive()
            if self.sightings is not None and connection is self._in:
                self._sight(self.sightings, event)

    def _sight(self, sightings: EventSightings, event: bytes) -> None:
        try:
            sighting = sightings.take(event, self._team_s(), time())
        except EventRefusedError as error:
            if sightings.refused[error.refusal] == 1:
                self._report(printable(f"event refused, reported once: {error}"))
        else:
            if sighting is not None:
                self._bus.publish(TOPIC, sighting)

    def _team_s(self) -> float | None:
        """Return the team's time, None while no vehicle flies this version of the mission."""
        try:
            self._missions.require_version("cot")
        except VehicleRefusedError:
            return None
        return self._clock.now_s(monotonic())

    def _take(self, message: BusMessage) -> None:
        """Take a message of the team."""
        self._missions.receive(message)
        if isinstance(message, MemberState):
            self._clock.receive(message.sender, message.time_s, monotonic())
            self._team.take(message, monotonic())


class TeamEvents:
    """The events of a team, from the states that its vehicles send; it knows no network and no clock."""

    def __init__(self, mission: Mission, geoid_m: float | None) -> None:
        self._mission, self._frame, self._geoid_m = mission, mission.mission_frame(), geoid_m
        self._states: dict[int, tuple[MemberState, float]] = {}
        self._seen: dict[int, tuple[TargetPackage, float]] = {}
        self._alarmed: set[int] = set()
        self._prefix, self._name = f"cordon-{mission.network.team}", mission.mission.name

    def take(self, state: MemberState, now_s: float) -> None:
        """Take a state of a vehicle of the mission, received at `now_s` [wall s]."""
        if state.sender not in self._mission.ids:
            return
        self._states[state.sender] = state, now_s
        for package in state.sightings:
            self._seen[package.target or 0] = package, now_s

    def events(self, now_s: float, unix_s: float) -> Iterator[bytes]:
        """Return the events that are due at `now_s` [wall s], stamped with `unix_s` [Unix s]."""
        states = [state for state, received_s in self._states.values() if now_s - received_s < _SILENT_S]
        for state in sorted(states, key=lambda each: each.sender):
            yield from self._of_vehicle(state, unix_s)
        yield from self._of_targets(states, now_s, unix_s)

    def _of_vehicle(self, state: MemberState, unix_s: float) -> Iterator[bytes]:
        (x, y), (x_rate, y_rate) = state.position_m, state.velocity_m_s
        place = self._frame.geodetic_from_mission((x, y, state.altitude_m))
        north, east, _ = self._frame.ned_from_mission((x_rate, y_rate, 0.0))
        uid, callsign = f"{self._prefix}-vehicle-{state.sender}", f"{self._name} {state.sender}"
        about = f"{state.tactic}; {state.altitude_m:.1f} m above the mission's origin"
        remarks = f"{about}; {state.alert}" if state.alert else about
        motion = degrees(atan2(east, north)) % 360.0, hypot(x_rate, y_rate)
        sigma_m = state.position_sigma_m
        yield vehicle_event(uid, callsign, place, self._geoid_m, sigma_m, motion, remarks=remarks, now_s=unix_s)
        alarm = state.alert if severity(state.alert) == "alarm" else ""
        if alarm or state.sender in self._alarmed:
            (self._alarmed.add if alarm else self._alarmed.discard)(state.sender)
            yield alarm_event(f"{uid}-alarm", callsign, place, self._geoid_m, sigma_m, alarm, unix_s)

    def _of_targets(self, states: list[MemberState], now_s: float, unix_s: float) -> Iterator[bytes]:
        """Return the events of targets and rings: a target is in the middle of its ring, else where it was seen."""
        rings = self._mission.rings
        centres: dict[int, tuple[float, float]] = {}
        for number in range(max(len(rings), 1)):
            known_m = [_centre_m(each) for each in states if each.angle is not None and each.ring_number == number]
            if known_m:
                x, y = (sum(values) / len(known_m) for values in zip(*known_m, strict=True))
                centres[rings[number].target if rings else 0] = x, y
                name = rings[number].name if len(rings) > 1 else ""
                ring = f"{self._name} ring {name}".strip()
                place = self._frame.geodetic_from_mission((x, y, 0.0))
                yield ring_event(self._uid("ring", name), ring, place, self._radius_m(states, number), unix_s)
        names = [each.name for each in self._mission.targets]
        for number in range(max(len(names), 1)):
            place_m, sigma_m = centres.get(number), None
            if place_m is None and number in self._seen:
                package, seen_s = self._seen[number]
                if now_s - seen_s < self._mission.target_filter.stale_after_s:
                    place_m = package.position_m
                    sigma_m = sqrt((package.covariance_m2[0] + package.covariance_m2[2]) / 2.0)
            if place_m is not None:
                name = names[number] if len(names) > 1 else ""
                callsign = f"{self._name} target {name}".strip()
                place = self._frame.geodetic_from_mission((*place_m, 0.0))
                yield target_event(self._uid("target", name), callsign, place, sigma_m, unix_s)

    def _uid(self, kind: str, name: str) -> str:
        return "-".join(filter(None, (self._prefix, kind, name)))

    def _radius_m(self, states: list[MemberState], number: int) -> float:
        """Return the radius of a ring as it was commanded last, else the mission's."""
        rings = [commanded[number] for each in states if len(commanded := commanded_rings(each)) > number]
        missions = self._mission.rings[number].encirclement if self._mission.rings else self._mission.encirclement
        return newest_ring(rings).radius_m or missions.radius_m


def _centre_m(state: MemberState) -> tuple[float, float]:
    """Return the position of the target to which a vehicle's place on the ring refers."""
    assert state.angle is not None
    (x, y), angle = state.position_m, state.angle
    return x - angle.radius_m * cos(angle.bearing_rad), y - angle.radius_m * sin(angle.bearing_rad)
