"""The failsafe table - what may go wrong, and what a vehicle does about it - and the monitor that carries it out.

`docs/safety.md` is made from the table. The tactic machine (`agents/tactics.py`) defines what a
reaction does; `agents/safety/fault_detector.py` detects the conditions.
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from agents.settings.config import AgentConfig
from agents.tactics import Event, Tactic


class Condition(Enum):
    """What may go wrong: the name shown to people, sent to peers and written to logs."""

    TELEMETRY_STALE = "telemetry stale"
    ESTIMATOR_JUMPED = "estimator jumped"
    PILOT_TOOK_OVER = "pilot took over"
    BATTERY_CRITICAL = "battery critical"
    BATTERY_LOW = "battery low"
    FENCE_LEFT = "fence left"
    TOO_CLOSE = "too close"
    TARGET_STALE = "target stale"
    TARGET_JUMPED = "target jumped"
    PLAN_FAILING = "plan failing"
    BUS_LOST = "bus lost"
    PEERS_SILENT = "all peers silent"
    LATE_TICKS = "late ticks"
    BUS_FLOODED = "bus flooded"
    CLOCK_STEPPED = "peer's clock stepped"
    LEADER_LOST = "leader lost"
    PEER_SILENT = "peer silent"
    OPERATOR_LOST = "operator lost"


class Reaction(Enum):
    """What is done about it, from the least to the gravest."""

    DEGRADE = "fly on and report"
    ASIDE = "step aside"
    HOLD = "hold"
    END = "hold, then return and land as at the mission's end"
    RETURN = "return and land"
    LAND = "land"
    HAND_OVER = "hand over to the pilot"


RESUME = "by `resume`, refused while it lasts"
BY_ITSELF = "by itself, once it is over"
NOT_IN_THE_AIR = "not in the air"
_GRADUALLY = (Reaction.ASIDE, Reaction.HOLD, Reaction.LAND)


@dataclass(frozen=True, slots=True)
class Row:
    """One condition: how it is detected, for how long it is tolerated, what is done, and how that is left.

    `grace` names the setting of the grace time (empty: none); with `by_wall` it counts on the wall's clock, for links
    take wall time also where the mission's passes faster. Each further reaction follows `failsafe.escalation_s` later
    if the condition persists. `descending` is what a vehicle does that is coming down already, if not go on; a row of
    the `shell` is carried out outside the core.
    """

    condition: Condition
    detected: str
    grace: str
    reactions: tuple[Reaction, ...]
    left: str
    by_wall: bool = False
    descending: Reaction | None = None
    shell: bool = False


TABLE = (
    Row(
        Condition.TELEMETRY_STALE,
        "no sample of the vehicle's own motion",
        "safety.telemetry_timeout_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        by_wall=True,
        # On its way down a vehicle without position lands where it is.
        descending=Reaction.LAND,
    ),
    Row(
        Condition.ESTIMATOR_JUMPED,
        "the autopilot's position is a metre or more from one sample to the next where its velocity does not lead, and "
        "stays there for the profile's `own_filter.gate_timeout_s`: the filter starts again; it lasts until "
        "`tuning.failsafe.settle_s` after",
        "",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
    ),
    Row(
        Condition.PILOT_TOOK_OVER,
        "the flight mode is one that cordon did not request, or it disarmed: a pilot, a ground station, the "
        "autopilot's own failsafe",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`, which requests offboard again",
    ),
    Row(
        Condition.BATTERY_CRITICAL,
        "less than `failsafe.battery_critical` of the battery left",
        "failsafe.battery_s",
        (Reaction.LAND,),
        NOT_IN_THE_AIR,
    ),
    Row(
        Condition.BATTERY_LOW,
        "less than `failsafe.battery_low` of the battery left",
        "failsafe.battery_s",
        (Reaction.RETURN,),
        NOT_IN_THE_AIR,
    ),
    Row(
        Condition.FENCE_LEFT,
        "the vehicle is outside the mission's fence",
        "failsafe.fence_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
    ),
    Row(
        Condition.TOO_CLOSE,
        "despite the guard, a peer at the same height is nearer than `tuning.failsafe.separation_share` of "
        "`safety.separation_m`",
        "failsafe.separation_s",
        _GRADUALLY,
        RESUME,
    ),
    Row(
        Condition.TARGET_STALE,
        "on the ring, and no sensor has seen the target",
        "target_filter.stale_after_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
    ),
    Row(
        Condition.TARGET_JUMPED,
        "on the ring, and all sightings have disagreed with the estimate for `tuning.target_filter.gate_timeout_s`: "
        "the filter starts again; it lasts until `tuning.failsafe.settle_s` after the last time",
        "",
        _GRADUALLY,
        RESUME,
    ),
    Row(
        Condition.PLAN_FAILING,
        "no tick in a row solves its plan, or its guard",
        "failsafe.plan_s",
        _GRADUALLY,
        RESUME,
    ),
    Row(
        Condition.BUS_LOST,
        "the Zenoh session is closed or broken",
        "failsafe.bus_lost_s",
        _GRADUALLY,
        RESUME,
        by_wall=True,
    ),
    Row(
        Condition.PEERS_SILENT,
        "every peer was received, none is any more, and not all had published that they land or that a pilot "
        "flies them",
        "failsafe.peers_silent_s",
        _GRADUALLY,
        RESUME,
        by_wall=True,
    ),
    Row(
        Condition.LATE_TICKS,
        "every tick in a row comes a whole period late or more",
        "failsafe.late_s",
        (Reaction.DEGRADE, *_GRADUALLY),
        f"{BY_ITSELF}; when aside or worse {RESUME}",
        by_wall=True,
    ),
    Row(
        Condition.BUS_FLOODED,
        "the bus refuses more than `tuning.failsafe.flood_per_s` messages a second before it decodes them, because of "
        "their key, sender, length or rate",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.CLOCK_STEPPED,
        "all messages of a peer are dated more than `tuning.failsafe.clock_step_s` off what was usual",
        "failsafe.clock_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.LEADER_LOST,
        "the leader was received, is not any more, and had not published that it lands or that a pilot flies it; the "
        "next in line leads",
        "failsafe.peer_silent_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.PEER_SILENT,
        "the same of another peer; the others close the gap",
        "failsafe.peer_silent_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.OPERATOR_LOST,
        "the terminal of `cordon fly` is gone (SIGHUP), or it was signalled to end (SIGTERM, SIGINT)",
        "",
        (Reaction.END,),
        NOT_IN_THE_AIR,
        shell=True,
    ),
)
"""Among equally grave conditions the one that stands first is the one that is reported."""

ROWS = {row.condition: row for row in TABLE}
_ORDER = {row.condition: place for place, row in enumerate(TABLE)}
_GRAVITY = {reaction: gravity for gravity, reaction in enumerate(Reaction)}
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
_ROUNDING_S = 1e-9


class Symptom(NamedTuple):
    """A detected condition: since when it is there, and the detail shown to people."""

    since_s: float
    detail: str


@dataclass(slots=True)
class _Alert:
    """A condition whose grace time is over: how far its reactions have got, and whether it is there still."""

    row: Row
    reached: int
    detail: str
    present: bool

    @property
    def reaction(self) -> Reaction:
        return self.row.reactions[self.reached]

    @property
    def sticky(self) -> bool:
        return self.reaction is not Reaction.DEGRADE

    @property
    def gravity(self) -> tuple[int, int]:
        return _GRAVITY[self.reaction], -_ORDER[self.row.condition]

    def demand(self, tactic: Tactic) -> Reaction:
        """Return what it takes: on the way down that may be more than elsewhere."""
        if tactic is Tactic.RETURN_AND_LAND and self.present and self.row.descending is not None:
            return self.row.descending
        return self.reaction


class FailsafeMonitor:
    """Takes the faults of each tick, returns the event that is due, and remembers the conditions reacted to."""

    def __init__(self, config: AgentConfig) -> None:
        self._grace_s = {row.condition: grace_s(row, config) for row in TABLE}
        self._escalation_s = config.failsafe.escalation_s
        self._time_scale = 1.0
        self._alerts: dict[Condition, _Alert] = {}
        self._news: list[str] = []

    def set_time_scale(self, factor: float) -> None:
        """Let what counts on the wall's clock take `factor` times as long."""
        self._time_scale = factor

    @property
    def alert(self) -> str:
        """The gravest condition, empty if there is none."""
        if not self._alerts:
            return ""
        return max(self._alerts.values(), key=lambda alert: alert.gravity).row.condition.value

    @property
    def active(self) -> Container[Condition]:
        """The conditions whose grace time is over, and that are not left yet."""
        return self._alerts

    def react(self, now_s: float, present: Mapping[Condition, Symptom], tactic: Tactic) -> Event | None:
        """Return the event that is due in this tactic, None if it is grave enough already.

        A vehicle that lands reacts to nothing any more.
        """
        if not (present or self._alerts) or tactic is Tactic.LAND:
            return None
        lasting = [condition for condition, symptom in present.items() if self._take(now_s, condition, symptom)]
        for condition in [c for c, alert in self._alerts.items() if alert.present and c not in lasting]:
            self._end(condition)
        return self._due(tactic)

    def latch(self, condition: Condition, detail: str) -> None:
        """Remember a condition that the shell has reacted to already."""
        self._alerts[condition] = _Alert(ROWS[condition], 0, detail, present=False)
        self._tell(condition)

    def refuse_resume(self) -> str | None:
        """Return why the vehicle must not resume, None if it may: what stopped it is still there."""
        reasons = [
            f"{condition.value}: {alert.detail}"
            for condition, alert in self._alerts.items()
            if alert.present and alert.sticky
        ]
        return "; ".join(reasons) or None

    def resume(self) -> None:
        """Forget what stopped the vehicle and is over."""
        for condition in [c for c, alert in self._alerts.items() if not alert.present]:
            del self._alerts[condition]

    def news(self) -> list[str]:
        """Return what has changed since the last time, as text for the notes."""
        if not self._news:
            return []
        news, self._news = self._news, []
        return news

    def _take(self, now_s: float, condition: Condition, symptom: Symptom) -> bool:
        """Take in a fault, and return whether it has lasted longer than its grace time."""
        row = ROWS[condition]
        time_scale = self._time_scale if row.by_wall else 1.0
        borne_s = now_s - symptom.since_s - self._grace_s[condition] * time_scale + _ROUNDING_S
        if borne_s < 0.0:
            return False
        reached = min(int(borne_s / (self._escalation_s * time_scale)), len(row.reactions) - 1)
        alert = self._alerts.get(condition)
        if alert is None:
            self._alerts[condition] = _Alert(row, reached, symptom.detail, present=True)
            self._tell(condition)
            return True
        alert.present, alert.detail = True, symptom.detail
        if reached > alert.reached:
            alert.reached = reached
            self._tell(condition)
        return True

    def _tell(self, condition: Condition) -> None:
        alert = self._alerts[condition]
        self._news.append(f"{condition.value}: {alert.detail}: {alert.reaction.value}")

    def _end(self, condition: Condition) -> None:
        alert = self._alerts[condition]
        alert.present = False
        self._news.append(f"{condition.value}: cleared" + ("; resume continues the mission" if alert.sticky else ""))
        if not alert.sticky:
            del self._alerts[condition]

    def _due(self, tactic: Tactic) -> Event | None:
        demands = (alert.demand(tactic) for alert in self._alerts.values())
        gravest = max(demands, key=_GRAVITY.__getitem__, default=Reaction.DEGRADE)
        got = _GRAVITY[_AMOUNTS_TO.get(tactic, Reaction.DEGRADE)]
        return _EVENTS[gravest] if _GRAVITY[gravest] > got and gravest in _EVENTS else None


def grace_s(row: Row, config: AgentConfig) -> float:
    """Return the grace time of a condition under a configuration."""
    if not row.grace:
        return 0.0
    section, key = row.grace.split(".")
    return float(getattr(getattr(config, section), key))
