"""What a listener knows of a team: the last words of each vehicle, and what has changed about it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from agents.team.messages import (
    TOPICS,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    decode,
)

SILENT_AFTER_S = 1.0
"""Vehicles speak ten times a second of mission time, which passes at the wall's pace or faster."""


@dataclass(frozen=True, slots=True)
class WatchRow:
    """One vehicle by its own words; None is what it has not said. `age_s` is how old the last of them is [wall s]."""

    vehicle_id: int
    age_s: float | None = None
    tactic: str = "-"
    position_m: tuple[float, float] | None = None
    altitude_m: float | None = None
    radius_m: float | None = None
    angular_rate_rad_s: float | None = None
    alert: str = ""

    @property
    def silent(self) -> bool:
        """Whether it has fallen silent."""
        return self.age_s is not None and self.age_s > SILENT_AFTER_S


@dataclass(slots=True)
class _Heard:
    """The last words of one vehicle, and when they came [wall s]."""

    state: MemberState
    at_s: float
    angle: NeighbourAngle | None = None
    told_silent: bool = False


@dataclass(slots=True)
class TeamPicture:
    """What a listener knows of a team: the last words of each vehicle, and news of what has changed."""

    vehicle_ids: Sequence[int]
    _heard: dict[int, _Heard] = field(default_factory=dict)
    _known: set[tuple[object, ...]] = field(default_factory=set)
    _news: list[str] = field(default_factory=list)

    @property
    def anybody(self) -> bool:
        """Whether anybody has been heard at all."""
        return bool(self._heard)

    def hear(self, payload: bytes, now_s: float) -> None:
        """Take what somebody said on the bus at `now_s` [wall s]; what is no message of ours is left alone."""
        try:
            message = decode(payload)
        except ValueError:
            return
        match message:
            case MemberState():
                self._hear_state(message, now_s)
            case NeighbourAngle() if message.sender in self._heard:
                self._heard[message.sender].angle = message
            case OperatorCommand() | CommandAnswer():
                self._hear_order(message)
            case _:
                pass

    def rows(self, now_s: float) -> list[WatchRow]:
        """Return a row for each vehicle of the mission, and for whoever else speaks."""
        return [self._row(each, now_s) for each in sorted({*self.vehicle_ids, *self._heard})]

    def news(self, now_s: float) -> list[str]:
        """Return what has happened since the last time, in people's words."""
        for vehicle_id, heard in sorted(self._heard.items()):
            if now_s - heard.at_s > SILENT_AFTER_S and not heard.told_silent:
                heard.told_silent = True
                self._news.append(f"vehicle {vehicle_id}: fell silent, its tactic was {heard.state.tactic}")
        news, self._news = self._news, []
        return news

    def _hear_state(self, state: MemberState, now_s: float) -> None:
        last = self._heard.get(state.sender)
        self._heard[state.sender] = _Heard(state, now_s, None if last is None else last.angle)
        name = f"vehicle {state.sender}"
        if last is None:
            self._news.append(f"{name}: heard, its tactic is {state.tactic}")
        elif last.told_silent:
            self._news.append(f"{name}: is heard again")
        if last is not None and state.tactic != last.state.tactic:
            self._news.append(f"{name}: {last.state.tactic} -> {state.tactic}")
        if state.alert != ("" if last is None else last.state.alert):
            self._news.append(f"{name}: {f'alert: {state.alert}' if state.alert else 'no alert any more'}")

    def _hear_order(self, message: OperatorCommand | CommandAnswer) -> None:
        """Tell of commands and answers once, however often they are repeated."""
        if isinstance(message, OperatorCommand):
            key: tuple[object, ...] = (message.number,)
            whom = "all vehicles" if message.vehicle is None else f"vehicle {message.vehicle}"
            text = f"{whom} told by {message.origin}: {message.verb}"
        else:
            key = (message.number, message.sender, message.did)
            text = f"vehicle {message.sender} answers: {message.did}"
        if key not in self._known:
            self._known.add(key)
            self._news.append(text)

    def _row(self, vehicle_id: int, now_s: float) -> WatchRow:
        heard = self._heard.get(vehicle_id)
        if heard is None:
            return WatchRow(vehicle_id)
        state, angle = heard.state, heard.angle
        on_ring = angle is not None and abs(state.time_s - angle.time_s) < TOPICS[NeighbourAngle].age_max_s
        return WatchRow(
            vehicle_id,
            now_s - heard.at_s,
            state.tactic,
            state.position_m,
            state.altitude_m,
            angle.radius_m if angle is not None and on_ring else None,
            angle.angular_rate_rad_s if angle is not None and on_ring else None,
            state.alert,
        )
