"""Commands from the operator's page to the team: rights, confirmations, and each request once.

A request is carried out even if the page closes: its answers are on the bus, and appear as events.
"""

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

from agents.ports import VehicleRefusedError
from agents.tactics import Tactic
from agents.team.messages import RingValues
from agents.team.verbs import VERBS
from gcs.console.command_client import CommandClient, CommandResult
from gcs.console.rings import ring_names
from gcs.errors import InputError
from gcs.keys.identity import Identity, user_name
from gcs.keys.team_keys import team_keys
from gcs.mission.mission import Mission
from gcs.preflight.mission import ring_change_faults
from gcs.station.picture import AnswerPicture, CommandRequest, EventPicture, OperatorRights, SightingRequest
from gcs.station.target_reports import TargetReports

NO_ANSWER = "no answer"
UNDER_WAY_MAX = 16
_REFUSED = "refused: "
_REQUESTS_KEPT = 1000
_LOOKED_UP_EVERY_S = 1.0

OnAnswer = Callable[[AnswerPicture], None]


@dataclass(slots=True)
class _Taken:
    """An accepted request, its answers so far, and the pages that wait for more."""

    request: CommandRequest | SightingRequest
    began_s: float = field(default_factory=time.monotonic)
    answers: list[AnswerPicture] = field(default_factory=list)
    receivers: list[OnAnswer] = field(default_factory=list)

    def answer(self, vehicle_id: int | None, did: str, *, is_obeyed: bool, is_final: bool) -> None:
        """Send an answer to the pages that made the request."""
        after_s = time.monotonic() - self.began_s
        request = self.request
        answer = AnswerPicture(request.request, request.verb, vehicle_id, did, after_s, is_obeyed, is_final)
        self.answers.append(answer)
        for receive in self.receivers:
            receive(answer)


class Commands:
    """Sends the requests of all pages to the team with the operator's keys on this computer; without keys, none."""

    def __init__(self, mission: Mission, key: str | None, publish: Callable[[EventPicture], None]) -> None:
        """Take the mission, and the operator whose keys to use if there are several.

        Raises InputError when the team has no keys and needs them.
        """
        self._mission = mission
        self._keys = team_keys(mission)
        self._key = key
        self._publish = publish
        self._identity: Identity | None = None
        self._client: CommandClient | None = None
        self._reports = TargetReports(mission, self._keys)
        self._taken: OrderedDict[str, _Taken] = OrderedDict()
        self._under_way: set[asyncio.Task[None]] = set()
        self._read_only = "no flight runs"

    @property
    def rights(self) -> OperatorRights:
        """The operator's name and permitted commands."""
        sights = not self._reports.refusal
        if self._client is None or self._identity is None:
            return OperatorRights(read_only=self._read_only, sights=sights)
        may = tuple(verb for verb in self._identity.may if VERBS[verb].button or VERBS[verb].takes in ("place", "view"))
        return OperatorRights(self._identity.participant.name, may, sights=sights)

    @property
    def name(self) -> str:
        """Who acts by pages: the operator, before a flight that makes its keys this user; empty if read-only."""
        if self._identity is not None:
            return self._identity.participant.name
        return user_name() if self._mission.network.security is None else ""

    async def run(self, on_rights: Callable[[OperatorRights], None]) -> None:
        """Stay on the bus of the present flight, with its operator's keys, until cancelled.

        `on_rights` is called at the beginning, and whenever the rights have changed.
        """
        on_rights(self.rights)
        try:
            while True:
                before = self.rights
                await self._follow()
                if self.rights != before:
                    on_rights(self.rights)
                await asyncio.sleep(_LOOKED_UP_EVERY_S)
        finally:
            await asyncio.shield(self._leave())

    def take(self, request: CommandRequest | SightingRequest, receive: OnAnswer) -> None:
        """Begin to carry out a request; for a known one repeat its answers, and do not send it again."""
        if known := self._taken.get(request.request):
            for answer in known.answers:
                receive(answer)
            known.receivers.append(receive)
            return
        taken = self._taken[request.request] = _Taken(request, receivers=[receive])
        if len(self._taken) > _REQUESTS_KEPT:
            self._taken.popitem(last=False)
        if refusal := next(self._refusals(request), ""):
            taken.answer(None, f"{_REFUSED}{refusal}", is_obeyed=False, is_final=True)
            return
        if isinstance(request, SightingRequest):
            task = asyncio.create_task(self._report(taken, request))
        else:
            assert self._client is not None
            task = asyncio.create_task(self._carry_out(taken, request, self._client))
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)

    def _refusals(self, request: CommandRequest | SightingRequest) -> Iterator[str]:
        """Yield the reasons why a request is not sent."""
        if len(self._under_way) >= UNDER_WAY_MAX:
            yield f"{UNDER_WAY_MAX} commands are in progress: try again"
        if isinstance(request, CommandRequest):
            yield from self._command_faults(request)
        elif fault := self._reports.fault(request):
            yield fault

    def _command_faults(self, request: CommandRequest) -> Iterator[str]:
        if self._client is None:
            yield f"this page is read-only: {self._read_only}"
        if request.verb not in self.rights.may:
            yield f"operator {self.rights.name} may not command {request.verb} from this page"
        yield from self._ring_faults(request)
        if request.vehicles is not None and (not request.vehicles or set(request.vehicles) - set(self._mission.ids)):
            yield f"select vehicles of the mission ({', '.join(map(str, self._mission.ids))})"
        asked = self._mission.ids if request.vehicles is None else request.vehicles
        row, ended = VERBS[request.verb], set() if self._client is None else {*self._client.ended}
        if row.is_for_landed and request.vehicles is None:
            yield "select the vehicles that rejoin"
        if not row.is_for_landed and ended >= set(asked):
            yield "the flight of every vehicle that it is for has ended"
        confirmation = row.confirmation
        if confirmation == "word" and request.confirmation != request.verb:
            yield f"{request.verb} needs the word {request.verb} as confirmation"
        if confirmation == "pilots" and not request.overrides_pilot and (piloted := self._piloted(request)):
            yield f"a pilot flies {_named(piloted)}: confirm to take over"

    def _ring_faults(self, request: CommandRequest) -> Iterator[str]:
        """Yield why a request does not fit what its verb takes."""
        names, number, takes = ring_names(self._mission), request.ring_number, VERBS[request.verb].takes
        if VERBS[request.verb].is_for_team and request.vehicles is not None:
            yield f"{request.verb} commands the whole team"
        if takes == "place" and (request.place is None or request.vehicles is None or len(request.vehicles) != 1):
            yield f"{request.verb} sends one vehicle to a place"
        if takes == "ring" and request.ring is None:
            yield "the request names no value of the ring"
        if takes == "assign" and not names:
            yield "the mission has one ring, and every vehicle flies it"
        if takes == "assign" and request.vehicles is None:
            yield "select the vehicles to assign"
        if (number is not None and number >= len(names)) or (takes == "ring" and names and number is None):
            yield f"the request names no ring of the mission (rings: {', '.join(names) or 'one, without a name'})"

    def _piloted(self, request: CommandRequest) -> list[int]:
        tactics = {} if self._client is None else self._client.tactics
        asked = self._mission.ids if request.vehicles is None else request.vehicles
        return [each for each in asked if tactics.get(each) == Tactic.PILOT_OVERRIDE.value]

    async def _report(self, taken: _Taken, request: SightingRequest) -> None:
        """Send a report of the target; its answer is which vehicles were on the bus."""
        (x, y), sigma_m = request.position_m, request.sigma_m
        by = f" by {self.rights.name}" if self.rights.name else ""
        text = f"target reported from the page{by} at x {x:.1f} m, y {y:.1f} m, standard deviation {sigma_m:g} m"
        try:
            reached = await self._reports.send(request)
        except VehicleRefusedError as refusal:
            taken.answer(None, f"{_REFUSED}{refusal.reason}", is_obeyed=False, is_final=True)
        else:
            taken.answer(None, f"sent to {_named(reached)}", is_obeyed=True, is_final=True)
            self._publish(EventPicture(0, None, time.time(), "information", text))

    async def _carry_out(self, taken: _Taken, request: CommandRequest, client: CommandClient) -> None:
        """Send a request to all vehicles at once, or to each that it names."""
        vehicles = request.vehicles
        try:
            if vehicles is None:
                await self._send(taken, request, client, self._mission.ids, None)
            else:
                each = (self._send(taken, request, client, (one,), one) for one in dict.fromkeys(vehicles))
                await asyncio.gather(*each)
        except VehicleRefusedError as refusal:
            taken.answer(None, f"{_REFUSED}{refusal.reason}", is_obeyed=False, is_final=True)
        except InputError as error:
            taken.answer(None, f"{_REFUSED}{error.faults[0]}", is_obeyed=False, is_final=True)

    async def _send(
        self, taken: _Taken, request: CommandRequest, client: CommandClient, asked: Sequence[int], vehicle: int | None
    ) -> None:
        verb = request.verb

        def answered(sender: int, result: CommandResult) -> None:
            taken.answer(sender, result.did, is_obeyed=result.obeyed, is_final=result.is_final)

        ring, number = request.ring, request.ring_number
        faults = partial(ring_change_faults, self._mission, ring or RingValues(), ring=number or 0)
        given = ring or request.place
        results = await client.command(verb, asked, vehicle, given, answered, ring_faults=faults, ring_number=number)
        for vehicle_id, result in results.items():
            if result is None or not result.is_final:
                did = NO_ANSWER if result is None else f"{result.did}: not confirmed"
                taken.answer(vehicle_id, did, is_obeyed=False, is_final=True)
                text = f"{verb} from the page: {did}"
                self._publish(EventPicture(0, None, time.time(), "warning", text, vehicle_id))

    async def _follow(self) -> None:
        """Join the bus with the operator's keys of the present flight, and leave that of an earlier one."""
        await asyncio.to_thread(self._reports.follow)
        try:
            identity = await asyncio.to_thread(self._keys.identity, "operator", self._key)
            if self._client is not None and identity == self._identity:
                return
            await self._leave()
            client = CommandClient(self._mission, identity)
            await client.open()
        except VehicleRefusedError as refusal:
            self._read_only = refusal.reason
            await self._leave()
        except InputError as error:
            self._read_only = error.faults[0]
            await self._leave()
        else:
            self._identity, self._client = identity, client

    async def _leave(self) -> None:
        client, self._client, self._identity = self._client, None, None
        if client is not None:
            await client.close()


def _named(vehicles: Sequence[int]) -> str:
    return f"vehicle{'' if len(vehicles) == 1 else 's'} {', '.join(map(str, vehicles))}"
