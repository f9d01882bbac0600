"""The failsafe table: the conditions that a vehicle detects, and its reaction to each.

The table in `docs/safety.md` is generated from it. `agents/safety/fault_detector.py` detects the conditions,
`failsafe_monitor.py` carries the table out, and the tactic machine (`agents/tactics.py`) defines what a reaction does.
"""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from agents.settings.config import AgentConfig


class Condition(Enum):
    """The conditions; the values are shown to people, sent to peers and written to logs."""

    TELEMETRY_STALE = "telemetry stale"
    ESTIMATOR_JUMPED = "estimator jumped"
    REMOTE_CONTROL_LOST = "remote control lost"
    GROUND_STATION_LOST = "ground station lost"
    PILOT_TOOK_OVER = "pilot took over"
    BATTERY_CRITICAL = "battery critical"
    BATTERY_LOW = "battery low"
    NO_WAY_HOME = "no way home"
    ESTIMATOR_FAILING = "estimator failing"
    NOT_FOLLOWING = "not following"
    TILTED = "tilt too large"
    WINDY = "wind too strong"
    FENCE_LEFT = "fence left"
    ALTITUDE_LEFT = "altitude limit left"
    TOO_CLOSE = "too close"
    TARGET_STALE = "target stale"
    TARGET_JUMPED = "target jumped"
    PLAN_FAILING = "plan failing"
    BUS_LOST = "bus lost"
    PEERS_SILENT = "all peers silent"
    LATE_TICKS = "late ticks"
    BUS_FLOODED = "bus flooded"
    CLOCK_STEPPED = "peer's clock stepped"
    CLOCK_DRIFTED = "peer's clock drifted"
    ESTIMATOR_DEGRADED = "estimator degraded"
    LINK_DEGRADED = "link degraded"
    COMPUTER_SHORT = "computer short of memory or disk"
    LEADER_LOST = "leader lost"
    PEER_SILENT = "peer silent"
    PEER_DOUBTFUL = "peer doubtful"
    SIGHTINGS_CONTRADICT = "sightings contradict"
    TARGET_FROM_OUTSIDE = "target from outside only"
    NO_OPERATOR = "no operator on the bus"
    OPERATOR_LOST = "operator lost"


class Reaction(Enum):
    """The reactions, from the least to the most severe."""

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
    """One condition: its detection, its grace time, the reactions, and how the vehicle leaves them.

    `grace` names the setting of the grace time (empty: none); with `by_wall` it is in wall time, because links take
    wall time also when mission time passes faster. Each further reaction follows after another `failsafe.escalation_s`
    if the condition persists; if `choice` names a setting, that setting selects one of them instead. `descending` is
    the reaction of a vehicle that is already returning (None: it continues); a row with `shell` is carried out outside
    the core.
    """

    condition: Condition
    detected: str
    grace: str
    reactions: tuple[Reaction, ...]
    left: str
    by_wall: bool = False
    descending: Reaction | None = None
    shell: bool = False
    choice: str = ""


TABLE = (
    Row(
        Condition.TELEMETRY_STALE,
        "no sample of the vehicle's own motion",
        "safety.telemetry_timeout_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        by_wall=True,
        # A returning vehicle without a position estimate lands where it is.
        descending=Reaction.LAND,
    ),
    Row(
        Condition.ESTIMATOR_JUMPED,
        "for the profile's `own_filter.gate_timeout_s` the autopilot's position differs by a metre or more from the "
        "predicted one; lasts until `tuning.failsafe.settle_s` after the filter's restart",
        "",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
    ),
    Row(
        Condition.REMOTE_CONTROL_LOST,
        "the same as *pilot took over*, and the autopilot reports that its remote control is lost",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`, which requests offboard again",
    ),
    Row(
        Condition.GROUND_STATION_LOST,
        "the same, and the autopilot reports that its ground station is lost",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`, which requests offboard again",
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
        Condition.NO_WAY_HOME,
        "the remaining flight time is less than the flight home takes in the present wind, including landing and "
        "`failsafe.reserve_s`",
        "failsafe.battery_s",
        (Reaction.RETURN,),
        NOT_IN_THE_AIR,
    ),
    Row(
        Condition.ESTIMATOR_FAILING,
        "the autopilot's estimator rejects position, height or velocity (test ratio above 1), has no valid "
        "horizontal position, height or attitude, or reports that its GPS is spoofed",
        "failsafe.estimator_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        descending=Reaction.LAND,
    ),
    Row(
        Condition.NOT_FOLLOWING,
        "the vehicle is more than `tuning.failsafe.following_m` from where its plant would be under the setpoints sent",
        "failsafe.following_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        descending=Reaction.LAND,
    ),
    Row(
        Condition.TILTED,
        "the attitude is tilted by `tuning.failsafe.tilt_max_deg` or more: strong wind, or a failing motor",
        "failsafe.tilt_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        descending=Reaction.LAND,
    ),
    Row(
        Condition.WINDY,
        "the autopilot's estimator reports a wind of more than `tuning.failsafe.wind_max_m_s`",
        "failsafe.wind_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        descending=Reaction.LAND,
    ),
    Row(
        Condition.FENCE_LEFT,
        "the vehicle is outside its fence, the mission's or its own",
        "failsafe.fence_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
    ),
    Row(
        Condition.ALTITUDE_LEFT,
        "the vehicle is more than a metre above its `altitude_max_m` or below its `altitude_min_m`",
        "failsafe.fence_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
    ),
    Row(
        Condition.TOO_CLOSE,
        "despite the guard, a peer at the same height is nearer than `tuning.failsafe.separation_share` of "
        "`safety.separation_m`, or was when it fell silent or became doubtful, less than `safety.lost_avoided_s` ago",
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
        "on the ring, and all sightings have disagreed with the estimate for `tuning.target_filter.gate_timeout_s`; "
        "lasts until `tuning.failsafe.settle_s` after the filter's restart",
        "",
        _GRADUALLY,
        RESUME,
    ),
    Row(
        Condition.PLAN_FAILING,
        "every tick fails to solve the plan or the guard",
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
        "all peers were received before, none is now, and not all had published that they land or that a pilot "
        "flies them",
        "failsafe.peers_silent_s",
        _GRADUALLY,
        RESUME,
        by_wall=True,
    ),
    Row(
        Condition.LATE_TICKS,
        "every tick is late by a whole period or more",
        "failsafe.late_s",
        (Reaction.DEGRADE, *_GRADUALLY),
        f"{BY_ITSELF}; when aside or worse {RESUME}",
        by_wall=True,
    ),
    Row(
        Condition.BUS_FLOODED,
        "the bus refuses more than `tuning.failsafe.flood_per_s` messages a second: wrong key, sender, length or rate",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.CLOCK_STEPPED,
        "the time stamps of all messages of a peer have shifted by more than half a second",
        "failsafe.clock_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.CLOCK_DRIFTED,
        "the time stamps of a peer have drifted by more than half a second since its first messages",
        "failsafe.clock_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.ESTIMATOR_DEGRADED,
        "a test ratio of the autopilot's estimator is above 0.5, its GPS has no three-dimensional fix, fewer than 6 "
        "satellites, or is jammed",
        "failsafe.estimator_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.LINK_DEGRADED,
        "more than 10 % of the messages on the link are lost, its radio reports a full buffer, or its round trip takes "
        "more than 0.5 s",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.COMPUTER_SHORT,
        "the computer has less than 5 % of its memory available, or less than 200 MB of disk for the flight log",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.LEADER_LOST,
        "the leader is no longer received, and had not published that it lands or that a pilot flies it; the next in "
        "line leads",
        "failsafe.peer_silent_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.PEER_SILENT,
        "the same for another peer; the others close the gap",
        "failsafe.peer_silent_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        by_wall=True,
    ),
    Row(
        Condition.PEER_DOUBTFUL,
        "three states of a peer contradict each other: no vehicle can fly them in sequence, or two sources send "
        "them; lasts until 5 s after the last one",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.SIGHTINGS_CONTRADICT,
        "three sightings of a peer or an external source are farther from the own sensor's than their covariances "
        "allow; lasts until 5 s after the last one",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.TARGET_FROM_OUTSIDE,
        "no sensor of the team has seen the target for `target.stale_after_s`, but external sources report it",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.NO_OPERATOR,
        'all operators have left the bus; not checked if `failsafe.no_operator` is "go_on"',
        "failsafe.no_operator_s",
        (Reaction.HOLD, Reaction.RETURN),
        "by `resume`",
        by_wall=True,
        choice="failsafe.no_operator",
    ),
    Row(
        Condition.OPERATOR_LOST,
        "the terminal of `cordon fly` was closed (SIGHUP), or it received SIGTERM or SIGINT",
        "",
        (Reaction.END,),
        NOT_IN_THE_AIR,
        shell=True,
    ),
)
"""Among equally severe conditions the first one in the table is reported."""

ROWS = {row.condition: row for row in TABLE}
_CHOICES = {"hold": Reaction.HOLD, "return": Reaction.RETURN}
POSITION_ALERTS = frozenset(
    each.value for each in (Condition.TELEMETRY_STALE, Condition.ESTIMATOR_JUMPED, Condition.ESTIMATOR_FAILING)
)
"""The alerts with which a vehicle's position may jump."""


def grace_s(row: Row, config: AgentConfig) -> float:
    """Return the grace time of a condition under a configuration."""
    return _setting(row.grace, config) if row.grace else 0.0


def chosen(row: Row, config: AgentConfig) -> Row:
    """Return a row with the reactions that the configuration selects."""
    reaction = _CHOICES.get(_setting(row.choice, config)) if row.choice else None
    return row if reaction is None else replace(row, reactions=(reaction,))


def _setting(name: str, config: AgentConfig) -> Any:
    section, key = name.split(".")
    return getattr(getattr(config, section), key)
