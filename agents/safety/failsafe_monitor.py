"""The monitor of the failsafe table: which conditions have exceeded their grace time, and which event is due."""

from collections.abc import Container, Mapping
from dataclasses import dataclass
from math import inf
from typing import Final, NamedTuple

from agents.notes import AlertChange
from agents.safety.failsafe import OVERRIDES, RESUMES_MAX, TABLE, Condition, Reaction, Row, chosen, grace_s
from agents.settings.config import AgentConfig
from agents.tactics import Event, Tactic, next_tactic
from agents.team.messages import NextChange

_ORDER = {row.condition: place for place, row in enumerate(TABLE)}
_SEVERITY = {reaction: severity for severity, reaction in enumerate(Reaction)}
_EVENTS = {
    Reaction.ASIDE: Event.STEP_ASIDE,
    Reaction.HOLD: Event.HOLD,
    Reaction.RETURN: Event.RETURN,
    Reaction.LAND: Event.LAND,
}
_AMOUNTS_TO = {
    Tactic.ASIDE: Reaction.ASIDE,
    Tactic.HOLD: Reaction.HOLD,
    Tactic.RETURN_AND_LAND: Reaction.RETURN,
    Tactic.LAND: Reaction.LAND,
    Tactic.PILOT_OVERRIDE: Reaction.HAND_OVER,
}
_STOPPED = (Tactic.ASIDE, Tactic.HOLD)
_ROUNDING_S: Final = 1e-9
SETTLED_S: Final = 0.5
OUTLASTS_S: Final = 1.0
"""A consequence that outlasts its cause by more is an alert of its own."""
COUNTED_SHARE: Final = 0.5
COUNTED_MIN_S: Final = 2.0
"""The end of a grace time is announced once this share of it has passed; shorter ones are over before it is read."""


class Symptom(NamedTuple):
    """A detected condition: when it began, and the detail shown to people."""

    since_s: float
    detail: str


@dataclass(slots=True)
class _Alert:
    """A condition whose grace time is over: the reaction reached, and whether the condition is still present.

    `noted` is the reaction that was noted last, None before: a consequence of another condition, as it was last at
    `explained_s`, is not noted. `over_s` is when the condition was last found to be over.
    """

    row: Row
    reached: int
    detail: str
    present: bool
    noted: int | None = None
    explained_s: float = -inf
    over_s: float = inf

    @property
    def reaction(self) -> Reaction:
        return self.row.reactions[self.reached]

    @property
    def sticky(self) -> bool:
        return self.reaction is not Reaction.DEGRADE

    @property
    def binds(self) -> bool:
        """Whether it refuses a resume. NO_OPERATOR does not: an operator has sent the resume."""
        return self.present and self.row.condition is not Condition.NO_OPERATOR

    @property
    def severity(self) -> tuple[int, bool, int]:
        """Of equally severe conditions one that is present comes before one that is over: it acts next."""
        return _SEVERITY[self.reaction], self.present, -_ORDER[self.row.condition]

    def demand(self, tactic: Tactic) -> Reaction:
        """Return the reaction that is due; during a return it may be more severe."""
        if tactic is Tactic.RETURN_AND_LAND and self.present and self.row.descending is not None:
            return self.row.descending
        return self.reaction


def _first(change: NextChange) -> tuple[float, int]:
    """The order of changes: the earliest, of several at once the most severe."""
    return change.at_s, -_SEVERITY[_AMOUNTS_TO.get(Tactic(change.tactic), Reaction.DEGRADE)]


class FailsafeMonitor:
    """Takes the faults of each tick, returns the event that is due, and keeps the active conditions."""

    def __init__(self, config: AgentConfig) -> None:
        self._rows = {row.condition: chosen(row, config) for row in TABLE}
        self._grace_s = {row.condition: grace_s(row, config) for row in TABLE}
        self._escalation_s = config.failsafe.escalation_s
        # By then the own filter agrees with what it receives, or has restarted.
        self._resume_s = max(config.failsafe.resume_s, config.own_filter.gate_timeout_s + SETTLED_S)
        self._resumes_left = RESUMES_MAX if config.failsafe.resume == "auto" else 0
        self._stopped_itself, self._start_s = False, inf
        self._time_scale = 1.0
        self._present: Mapping[Condition, Symptom] = {}
        self._alerts: dict[Condition, _Alert] = {}
        self._news: list[AlertChange] = []

    def set_time_scale(self, factor: float) -> None:
        """Set mission seconds per wall second, for grace times in wall time."""
        self._time_scale = factor

    @property
    def alerts(self) -> tuple[str, ...]:
        """The active conditions, the most severe first, and consequences of others last."""
        if not self._alerts:
            return ()
        ranked = sorted(self._alerts.values(), key=lambda alert: alert.severity, reverse=True)
        ranked.sort(key=self._is_consequence)
        return tuple([alert.row.condition.value for alert in ranked])

    @property
    def blocks(self) -> str:
        """The most severe condition that refuses a resume, empty if none does."""
        blocking = self._blocking()
        return blocking[0].row.condition.value if blocking else ""

    @property
    def stops(self) -> bool:
        """Whether a condition is present that stops the vehicle, also if it holds already."""
        return any(alert.present and alert.sticky for alert in self._alerts.values())

    def waits_for_resume(self, tactic: Tactic) -> bool:
        """Return whether the vehicle stopped by itself, and all conditions of that are over."""
        stopped = [alert.present for alert in self._alerts.values() if alert.sticky]
        return tactic in _STOPPED and bool(stopped) and not any(stopped)

    @property
    def active(self) -> Container[Condition]:
        """The conditions whose grace time is over, until the vehicle has left their reaction."""
        return self._alerts

    def start(self, at_s: float) -> None:
        """Set the mission's start: no vehicle resumes by itself before."""
        self._start_s = at_s

    def react(self, now_s: float, present: Mapping[Condition, Symptom], tactic: Tactic) -> Event | None:
        """Return the event that is due: a reaction or, without one, a resume; None if neither is.

        A landing vehicle does not react any more.
        """
        self._present = present
        if not (present or self._alerts) or tactic is Tactic.LAND:
            return None
        lasting = [condition for condition, symptom in present.items() if self._take(now_s, condition, symptom)]
        for condition in lasting:
            self._note_change(self._alerts[condition], now_s)
        for condition in [c for c, alert in self._alerts.items() if alert.present and c not in lasting]:
            self._end(condition, now_s)
        event = self._due(tactic)
        if event is not None:
            self._stopped_itself |= event in (Event.STEP_ASIDE, Event.HOLD)
        elif now_s >= self._resumes_s(tactic):
            event, self._resumes_left = Event.RESUME, self._resumes_left - 1
        return event

    def leave_to_operator(self) -> None:
        """Leave the next resume to the operator, who has commanded the vehicle or has to judge its position."""
        self._stopped_itself = False

    def latch_override(self, condition: Condition, detail: str) -> None:
        """Record why the shell has handed the vehicle over, in place of a reason that tells less."""
        latched = [each for each in OVERRIDES if each in self._alerts]
        if latched and OVERRIDES.index(latched[0]) <= OVERRIDES.index(condition):
            return
        for each in latched:
            del self._alerts[each]
        self._alerts[condition] = _Alert(self._rows[condition], 0, detail, present=False)
        self._note_change(self._alerts[condition])

    def refuse_resume(self) -> str | None:
        """Return why the vehicle must not resume, which is a condition that is still present; None if it may."""
        return "; ".join([f"{alert.row.condition.value}: {alert.detail}" for alert in self._blocking()]) or None

    def next_change(self, tactic: Tactic, now_s: float) -> NextChange | None:
        """Return the next change of tactic if the present conditions last, None without one."""
        if not (self._present or self._alerts):
            return None
        changes = [
            change
            for condition, symptom in self._present.items()
            if (change := self._change_by(condition, symptom, tactic, now_s)) is not None
        ]
        if (resumes_s := self._resumes_s(tactic)) < inf:
            changes.append(NextChange(Tactic.FORMATION.value, resumes_s, f"{self.alerts[0]} is over"))
        return min(changes, key=_first) if changes else None

    def resume(self) -> None:
        """Drop the conditions that stopped the vehicle and are over."""
        self._stopped_itself = False
        for condition in [c for c, alert in self._alerts.items() if not alert.binds]:
            del self._alerts[condition]

    def news(self) -> list[AlertChange]:
        """Return the changes since the last call."""
        if not self._news:
            return []
        news, self._news = self._news, []
        return news

    def _take(self, now_s: float, condition: Condition, symptom: Symptom) -> bool:
        """Take a fault; return whether it has exceeded its grace time."""
        row = self._rows[condition]
        time_scale = self._time_scale if row.by_wall else 1.0
        over_grace_s = now_s - symptom.since_s - self._grace_s[condition] * time_scale + _ROUNDING_S
        if over_grace_s < 0.0:
            return False
        reached = min(int(over_grace_s / (self._escalation_s * time_scale)), len(row.reactions) - 1)
        alert = self._alerts.get(condition)
        if alert is None:
            self._alerts[condition] = _Alert(row, reached, symptom.detail, present=True)
            return True
        alert.present, alert.detail, alert.reached = True, symptom.detail, max(reached, alert.reached)
        return True

    def _change_by(self, condition: Condition, symptom: Symptom, tactic: Tactic, now_s: float) -> NextChange | None:
        """Return the change at the end of a condition's grace time or, after that, at its next reaction."""
        row, alert = self._rows[condition], self._alerts.get(condition)
        time_scale = self._time_scale if row.by_wall else 1.0
        after_s = self._grace_s[condition] * time_scale
        if alert is None or not alert.present:
            if after_s < COUNTED_MIN_S * time_scale or now_s - symptom.since_s < COUNTED_SHARE * after_s:
                return None
            reaction = row.descending if tactic is Tactic.RETURN_AND_LAND else None
            reaction = reaction or row.reactions[0 if alert is None else alert.reached]
        elif alert.reached + 1 < len(row.reactions):
            reaction = row.reactions[alert.reached + 1]
            after_s += (alert.reached + 1) * self._escalation_s * time_scale
        else:
            return None
        event = self._event(reaction, tactic)
        after = tactic if event is None else next_tactic(tactic, event)
        return None if after is tactic else NextChange(after.value, symptom.since_s + after_s, condition.value)

    def _blocking(self) -> list[_Alert]:
        """Return the conditions that refuse a resume, the most severe first."""
        blocking = [
            alert for alert in self._alerts.values() if alert.binds and alert.sticky and not self._is_consequence(alert)
        ]
        return sorted(blocking, key=lambda alert: alert.severity, reverse=True)

    def _is_consequence(self, alert: _Alert) -> bool:
        """Return whether another condition explains this one.

        That is an alert itself, or about to become one while this one changes nothing.
        """
        causes = [cause for cause in alert.row.explained_by if cause in self._present]
        return any(not alert.sticky or (cause in self._alerts and self._alerts[cause].present) for cause in causes)

    def _note_change(self, alert: _Alert, now_s: float = 0.0) -> None:
        if self._is_consequence(alert):
            alert.explained_s = now_s
        elif alert.noted != alert.reached and now_s - alert.explained_s > OUTLASTS_S:
            alert.noted = alert.reached
            self._news.append(AlertChange(alert.row.condition.value, alert.detail, alert.reaction.value))

    def _resumes_s(self, tactic: Tactic) -> float:
        """Return when the vehicle resumes by itself, infinity if that is the operator's to decide."""
        if tactic not in _STOPPED or not self._stopped_itself or self._resumes_left <= 0:
            return inf
        stopped = [alert for alert in self._alerts.values() if alert.sticky]
        if any(alert.present or not alert.row.resumes for alert in stopped):
            return inf
        if any(self._rows[condition].reactions != (Reaction.DEGRADE,) for condition in self._present):
            return inf  # it may be about to stop the vehicle again
        return max(max((alert.over_s for alert in stopped), default=inf) + self._resume_s, self._start_s)

    def _end(self, condition: Condition, now_s: float) -> None:
        alert = self._alerts[condition]
        alert.present, alert.over_s = False, now_s
        if alert.noted is not None:
            waits = alert.sticky and not self._blocking()
            self._news.append(AlertChange(condition.value, is_over=True, waits_for_resume=waits))
            alert.noted = None
        if not alert.sticky:
            del self._alerts[condition]

    def _due(self, tactic: Tactic) -> Event | None:
        demands = (alert.demand(tactic) for alert in self._alerts.values())
        return self._event(max(demands, key=_SEVERITY.__getitem__, default=Reaction.DEGRADE), tactic)

    @staticmethod
    def _event(reaction: Reaction, tactic: Tactic) -> Event | None:
        """Return the event of a reaction, None if the tactic is severe enough."""
        got = _SEVERITY[_AMOUNTS_TO.get(tactic, Reaction.DEGRADE)]
        return _EVENTS.get(reaction) if _SEVERITY[reaction] > got else None
