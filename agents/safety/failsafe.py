"""The failsafe table: what may go wrong, and what a vehicle does about it.

`docs/safety.md` is made from it. `agents/safety/fault_detector.py` detects the conditions, `failsafe_monitor.py`
carries the table out, and the tactic machine (`agents/tactics.py`) defines what a reaction does.
"""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from agents.settings.config import AgentConfig


class Condition(Enum):
    """What may go wrong: the name shown to people, sent to peers and written to logs."""

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
    if the condition persists; where `choice` names a setting, that chooses one of them instead. `descending` is what a
    vehicle does that is coming down already, if not go on; a row of the `shell` is carried out outside the core.
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
        "the remaining flight time is less than the way home takes at the present wind, landing and "
        "`failsafe.reserve_s` included",
        "failsafe.battery_s",
        (Reaction.RETURN,),
        NOT_IN_THE_AIR,
    ),
    Row(
        Condition.ESTIMATOR_FAILING,
        "the autopilot's estimator rejects position, height or velocity (test ratio above 1), lacks its horizontal "
        "position, height or attitude, or reports that its GPS is spoofed",
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
        "the autopilot's attitude is tilted by `tuning.failsafe.tilt_max_deg` or more: a wind that it hardly holds "
        "against, or a failing motor",
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
        Condition.CLOCK_DRIFTED,
        "a slow drift has dated the messages of a peer more than `tuning.failsafe.clock_step_s` off what was usual at "
        "first",
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
        Condition.PEER_DOUBTFUL,
        "three states of a peer contradict each other: no vehicle flies them one after another, or two sources send "
        "them; it lasts until 5 s after the last one. All places are kept clear of",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.SIGHTINGS_CONTRADICT,
        "three sightings of a peer or an external source are farther from the own sensor's than their covariances "
        "allow: they are not used while that sees the target; it lasts until 5 s after the last one",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.TARGET_FROM_OUTSIDE,
        "no sensor of the team has seen the target for `target.stale_after_s`, external sources report it",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
    ),
    Row(
        Condition.NO_OPERATOR,
        "an operator was on the team's bus, and none is any more; not looked for where `failsafe.no_operator` is "
        '"go_on"',
        "failsafe.no_operator_s",
        (Reaction.HOLD, Reaction.RETURN),
        "by `resume`",
        by_wall=True,
        choice="failsafe.no_operator",
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
_CHOICES = {"hold": Reaction.HOLD, "return": Reaction.RETURN}
POSITION_ALERTS = frozenset(
    each.value for each in (Condition.TELEMETRY_STALE, Condition.ESTIMATOR_JUMPED, Condition.ESTIMATOR_FAILING)
)
"""The alerts of a vehicle whose position may jump."""


def grace_s(row: Row, config: AgentConfig) -> float:
    """Return the grace time of a condition under a configuration."""
    return _setting(row.grace, config) if row.grace else 0.0


def chosen(row: Row, config: AgentConfig) -> Row:
    """Return a row with the reactions that a configuration chooses."""
    reaction = _CHOICES.get(_setting(row.choice, config)) if row.choice else None
    return row if reaction is None else replace(row, reactions=(reaction,))


def _setting(name: str, config: AgentConfig) -> Any:
    section, key = name.split(".")
    return getattr(getattr(config, section), key)
