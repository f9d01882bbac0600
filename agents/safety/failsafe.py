"""The failsafe table: the conditions that a vehicle detects, and its reaction to each.

A row owns its signal or names it, its thresholds are the constants that act, and the tables in `docs/safety.md` and
`docs/operator.md` are generated from it. `agents/safety/fault_detector.py` detects what no report shows,
`failsafe_monitor.py` carries the table out, and the tactic machine (`agents/tactics.py`) defines what a reaction does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Final

from agents.ports import Connection, GpsThreat, ModeSource, VehicleStatus
from agents.settings.config import AgentConfig
from agents.settings.sections import FailsafeSettings
from agents.situation.estimator import LINK_DELAY_MAX_S
from agents.situation.own_sensor import CONTRADICTED, CONTRADICTS_S
from agents.team.clock_watch import STEP_S
from agents.team.consistency_check import CONFIRMED, REPORTED_FOR_S
from estimation.filters.own import JUMP_M


class Condition(Enum):
    """The conditions; the values are shown to people, sent to peers and written to logs."""

    TELEMETRY_STALE = "telemetry stale"
    ESTIMATOR_JUMPED = "estimator jumped"
    ORIGIN_MOVED = "origin moved"
    REMOTE_CONTROL_LOST = "remote control lost"
    GROUND_STATION_LOST = "ground station lost"
    SETPOINTS_LOST = "setpoints not received"
    AUTOPILOT_FAILSAFE = "autopilot failsafe"
    PILOT_TOOK_OVER = "pilot took over"
    MODE_CHANGED = "mode changed"
    BATTERY_CRITICAL = "battery critical"
    BATTERY_LOW = "battery low"
    NO_WAY_HOME = "no way home"
    ESTIMATOR_FAILING = "estimator failing"
    NOT_FOLLOWING = "not following"
    TILTED = "tilt too large"
    WINDY = "wind too strong"
    FENCE_LEFT = "fence left"
    ZONE_ENTERED = "no-fly zone entered"
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
    BATTERY_WARNING = "battery warning"
    STATUS_STALE = "status stale"
    GIMBAL_FAILED = "gimbal failed"
    TRAFFIC_NEAR = "traffic near"
    COMPUTER_SHORT = "computer short of memory or disk"
    LEADER_LOST = "leader lost"
    PEER_SILENT = "peer silent"
    PEER_DOUBTFUL = "peer doubtful"
    SIGHTINGS_CONTRADICT = "sightings contradict"
    TARGET_FROM_OUTSIDE = "target from outside only"
    STIFFER = "stiffer than its profile"
    SOFTER = "softer than its profile"
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
    HAND_OVER = "hand over"


RATIO_MAX: Final = 1.0
RATIO_RESERVE: Final = 0.5
"""An estimator rejects a sensor at a test ratio above 1; 0.5 is the former arming limit of PX4."""
HEIGHT_OFF_MAX_M: Final = 4.0
HEIGHT_OFF_RESERVE_M: Final = 2.0
"""Of the height from that of another sensor. Barometers drift by a metre or two in a flight."""
COMPASS = "compass"
"""A rejected compass is no reason to land: estimators use the others, and compasses are disturbed near steel."""
SATELLITES_MIN: Final = 6
"""The minimum of PX4 (EKF2_REQ_NSATS) and of ArduPilot."""
FIX_DIMENSIONS: Final = 3
ALTITUDE_TOLERANCE_M: Final = 1.0
"""The guard keeps setpoints within the limits; the height error of an autopilot is up to half a metre."""
LINK_LOSS_MAX: Final = 0.1
"""Share of the messages on a link that are lost."""
SILENCES_PER_HOUR_MAX: Final = 0.3
"""Silences of a link that end offboard, or hold a vehicle, which its losses make likely in an hour."""
STATUS_STALE_S: Final = 30.0
"""Reports of the battery come every few seconds on a slow link."""
MEMORY_SHARE_MIN: Final = 0.05
"""Share of all memory. Below, Linux swaps and then kills processes."""
DISK_MIN_BYTES: Final = 200e6
"""A team of three writes this much in half an hour."""
DESCRIPTORS_SHARE_MAX: Final = 0.8
"""Share of the files and connections that a process may open. Strangers who connect to the bus use them up."""


def _tilted(status: VehicleStatus, limits: FailsafeSettings) -> str:
    return f"by {status.tilt_deg} degrees" if status.tilt_deg >= limits.tilt_max_deg else ""


def _windy(status: VehicleStatus, limits: FailsafeSettings) -> str:
    speed_m_s = status.wind_m_s
    return f"{speed_m_s:.1f} m/s" if speed_m_s is not None and speed_m_s > limits.wind_max_m_s else ""


def _failing(status: VehicleStatus, _limits: FailsafeSettings) -> str:
    ratio, rejected = status.estimator_ratio, ""
    if ratio is not None and ratio > RATIO_MAX and status.estimator_sensor != COMPASS:
        rejected = f"{status.estimator_sensor} rejected (test ratio {ratio:.1f})"
    spoofed = "GPS spoofed" if status.gps_threat is GpsThreat.SPOOFED else ""
    return ", ".join(filter(None, (rejected, status.estimator_fault, _height_off(status, HEIGHT_OFF_MAX_M), spoofed)))


def _height_off(status: VehicleStatus, tolerated_m: float) -> str:
    off_m = status.height_off_m
    if not off_m or abs(off_m) <= tolerated_m:
        return ""
    return f"height {off_m:+.1f} m off its {status.height_sensor}, beyond that sensor's accuracy"


def _degraded(status: VehicleStatus, _limits: FailsafeSettings) -> str:
    ratio, dimensions, satellites = status.estimator_ratio, status.gps_dimensions, status.satellites
    found = [off] if (off := _height_off(status, HEIGHT_OFF_RESERVE_M)) else []
    if ratio is not None and ratio > RATIO_RESERVE:
        found.append(f"{status.estimator_sensor} test ratio {ratio:.1f}")
    if dimensions is not None and dimensions < FIX_DIMENSIONS:
        found.append(f"GPS fix of {dimensions} dimensions" if dimensions else "no GPS fix")
    if satellites is not None and satellites < SATELLITES_MIN:
        found.append(f"{satellites} satellites")
    if status.gps_threat is GpsThreat.JAMMED:
        found.append("GPS jammed")
    return ", ".join(found)


def _without_setpoints(status: VehicleStatus, _limits: FailsafeSettings) -> str:
    if status.lost is not Connection.SETPOINTS:
        return ""
    return ": ".join(filter(None, ("its autopilot left offboard without them", status.link_fault)))


RESUME = "by `resume`, refused while it lasts"
BY_ITSELF = "by itself, once it is over"
NOT_IN_THE_AIR = "not in the air"
RESUMES_MAX: Final = 3
"""A vehicle resumes by itself so many times in a flight: a fault that returns more often is the operator's to judge."""
_GRADUALLY = (Reaction.ASIDE, Reaction.HOLD, Reaction.LAND)


@dataclass(frozen=True, slots=True)
class Row:
    """One condition: its detection, grace time, reactions, how the vehicle leaves them, and the operator's next step.

    `reported` is the signal of a condition that the autopilot or its link reports: it returns the detail shown to
    people, empty without the condition; all others are detected by `fault_detector.py`. `grace` names the setting of
    the grace time (empty: none); with `by_wall` it is in wall time, because links take wall time also when mission time
    passes faster. Each further reaction follows after another `failsafe.escalation_s` if the condition persists; if
    `choice` names a setting, that setting selects one of them instead. `descending` is the reaction of a vehicle that
    is already returning (None: it continues); a row with `shell` is carried out outside the core. While a condition of
    `explained_by` is present, this one is its consequence: it acts, but is no alert of its own. A condition that
    `resumes` leaves nothing in doubt once it is over: the vehicle may resume by itself if `failsafe.resume` says so.
    """

    condition: Condition
    detected: str
    grace: str
    reactions: tuple[Reaction, ...]
    left: str
    advice: str
    by_wall: bool = False
    descending: Reaction | None = None
    shell: bool = False
    choice: str = ""
    resumes: bool = False
    explained_by: tuple[Condition, ...] = ()
    reported: Callable[[VehicleStatus, FailsafeSettings], str] | None = None


TABLE = (
    Row(
        Condition.TELEMETRY_STALE,
        "no sample of the vehicle's own motion",
        "safety.telemetry_timeout_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "check its link; if it drifts, fly it by remote control",
        by_wall=True,
        # A returning vehicle without a position estimate lands where it is.
        descending=Reaction.LAND,
        resumes=True,
    ),
    Row(
        Condition.ESTIMATOR_JUMPED,
        f"the autopilot's position or height jumps by {JUMP_M:g} m or more; lasts until "
        "`tuning.failsafe.settle_s` after that",
        "",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "check where it is; resume once it hovers steadily",
    ),
    Row(
        Condition.ORIGIN_MOVED,
        "its origin moves; lasts as long",
        "",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "find out who moved it; then resume",
    ),
    Row(
        Condition.REMOTE_CONTROL_LOST,
        "*mode changed*, and the autopilot reports that its remote control is lost",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`",
        "restore its remote control, then resume",
    ),
    Row(
        Condition.GROUND_STATION_LOST,
        "the same for its ground station, or the link was lost",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`",
        "check its link, then resume",
    ),
    Row(
        Condition.SETPOINTS_LOST,
        "the autopilot's failsafe left offboard, and only its link's losses explain it",
        "",
        (Reaction.HOLD,),
        RESUME,
        "improve its link, then resume",
        resumes=True,
        reported=_without_setpoints,
    ),
    Row(
        Condition.AUTOPILOT_FAILSAFE,
        "the same, and its heartbeat begins to report a failsafe",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`",
        "read its messages; resume once the cause is over",
    ),
    Row(
        Condition.PILOT_TOOK_OVER,
        "the same, and it reports its pilot",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`",
        "ask its pilot before you resume",
    ),
    Row(
        Condition.MODE_CHANGED,
        "a flight mode that cordon did not request, or disarmed",
        "",
        (Reaction.HAND_OVER,),
        "by `resume`",
        "ask its pilot and read its messages, then resume",
    ),
    Row(
        Condition.BATTERY_CRITICAL,
        "less than `failsafe.battery_critical` of the battery left",
        "failsafe.battery_s",
        (Reaction.LAND,),
        NOT_IN_THE_AIR,
        "it lands where it is: clear the place below it",
    ),
    Row(
        Condition.BATTERY_LOW,
        "less than `failsafe.battery_low` of the battery left",
        "failsafe.battery_s",
        (Reaction.RETURN,),
        NOT_IN_THE_AIR,
        "it returns and lands: clear its landing place",
        explained_by=(Condition.BATTERY_CRITICAL,),
    ),
    Row(
        Condition.NO_WAY_HOME,
        "the remaining flight time is less than the flight home takes in the present wind, including landing and "
        "`failsafe.reserve_s`",
        "failsafe.battery_s",
        (Reaction.RETURN,),
        NOT_IN_THE_AIR,
        "it returns and lands: clear its way and landing place",
        explained_by=(Condition.BATTERY_CRITICAL, Condition.BATTERY_LOW),
    ),
    Row(
        Condition.ESTIMATOR_FAILING,
        f"the autopilot's estimator rejects position, height or velocity (test ratio above {RATIO_MAX:g}), has no "
        f"valid horizontal position, height or attitude, is {HEIGHT_OFF_MAX_M:g} m off its barometer, rangefinder or "
        "(beyond its accuracy) GPS, or reports spoofing",
        "failsafe.estimator_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "be ready to fly it by remote control; clear the place below it",
        descending=Reaction.LAND,
        reported=_failing,
    ),
    Row(
        Condition.NOT_FOLLOWING,
        "the vehicle is more than `tuning.failsafe.following_m` from where its plant would be under the setpoints sent",
        "failsafe.following_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "check for damage or wind; land it if it does not hover steadily",
        descending=Reaction.LAND,
    ),
    Row(
        Condition.TILTED,
        "the attitude is tilted by `tuning.failsafe.tilt_max_deg` or more: strong wind, or a failing motor",
        "failsafe.tilt_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "check for wind or a failing motor; land it",
        descending=Reaction.LAND,
        reported=_tilted,
    ),
    Row(
        Condition.WINDY,
        "the autopilot's estimator reports a wind of more than `tuning.failsafe.wind_max_m_s`",
        "failsafe.wind_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "resume in less wind, or land",
        descending=Reaction.LAND,
        reported=_windy,
    ),
    Row(
        Condition.FENCE_LEFT,
        "the vehicle is outside its fence, the mission's or its own",
        "failsafe.fence_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "fly it back by remote control, or let it land outside",
    ),
    Row(
        Condition.ZONE_ENTERED,
        "the vehicle is in a zone of `[[safety.no_fly]]`, at a height of the zone",
        "failsafe.fence_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "fly it out by remote control, or let it land in the zone",
    ),
    Row(
        Condition.ALTITUDE_LEFT,
        f"the vehicle is more than {ALTITUDE_TOLERANCE_M:g} m above its `altitude_max_m` or below its `altitude_min_m`",
        "failsafe.fence_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "correct its height by remote control, or land it",
    ),
    Row(
        Condition.TOO_CLOSE,
        "despite the guard, a peer at the same height is nearer than `tuning.failsafe.separation_share` of "
        "`safety.separation_m`, or was when it fell silent or became doubtful, less than `safety.lost_avoided_s` ago",
        "failsafe.separation_s",
        _GRADUALLY,
        RESUME,
        "hold all; land one of the two if they stay close",
    ),
    Row(
        Condition.TARGET_STALE,
        "on the ring, and no sensor has seen the target",
        "target_filter.stale_after_s",
        (Reaction.HOLD, Reaction.LAND),
        RESUME,
        "find the target; resume once a sensor sees it, or return",
    ),
    Row(
        Condition.TARGET_JUMPED,
        "on the ring, and all sightings have disagreed with the estimate for `tuning.target_filter.gate_timeout_s`; "
        "lasts until `tuning.failsafe.settle_s` after the filter's restart",
        "",
        _GRADUALLY,
        RESUME,
        "check the target's sensors; resume once they agree",
    ),
    Row(
        Condition.PLAN_FAILING,
        "every tick fails to solve the plan or the guard",
        "failsafe.plan_s",
        _GRADUALLY,
        RESUME,
        "hold it, then land it",
    ),
    Row(
        Condition.BUS_LOST,
        "the Zenoh session is closed or broken",
        "failsafe.bus_lost_s",
        _GRADUALLY,
        RESUME,
        "check its computer's network; Ctrl-C in its terminal lands it",
        by_wall=True,
        resumes=True,
    ),
    Row(
        Condition.PEERS_SILENT,
        "all peers were received before, none is now, and not all had published that they land or that a pilot "
        "flies them",
        "failsafe.peers_silent_s",
        _GRADUALLY,
        RESUME,
        "check its computer's network; Ctrl-C in its terminal lands it",
        by_wall=True,
        explained_by=(Condition.BUS_LOST,),
        resumes=True,
    ),
    Row(
        Condition.LATE_TICKS,
        "every tick is late by a whole period or more",
        "failsafe.late_s",
        (Reaction.DEGRADE, *_GRADUALLY),
        f"{BY_ITSELF}; when aside or worse {RESUME}",
        "close other programs on its computer; land it if this persists",
        by_wall=True,
        resumes=True,
    ),
    Row(
        Condition.BUS_FLOODED,
        "the bus refuses more than `tuning.failsafe.flood_per_s` messages a second: wrong key, sender, length or rate",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "find the sender and disconnect it",
        by_wall=True,
    ),
    Row(
        Condition.CLOCK_STEPPED,
        f"the time stamps of all messages of a peer have shifted by more than {STEP_S:g} s",
        "failsafe.clock_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "synchronise the clocks before the next flight",
        by_wall=True,
    ),
    Row(
        Condition.CLOCK_DRIFTED,
        f"the time stamps of a peer have drifted by more than {STEP_S:g} s since its first messages",
        "failsafe.clock_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "synchronise the clocks before the next flight",
    ),
    Row(
        Condition.ESTIMATOR_DEGRADED,
        f"a test ratio of the autopilot's estimator is above {RATIO_RESERVE:g} or its height "
        f"{HEIGHT_OFF_RESERVE_M:g} m off, its GPS has no {FIX_DIMENSIONS}D fix, "
        f"fewer than {SATELLITES_MIN} satellites, or is jammed",
        "failsafe.estimator_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "watch its position; return if it gets worse",
        reported=_degraded,
        explained_by=(Condition.ESTIMATOR_FAILING,),
    ),
    Row(
        Condition.LINK_DEGRADED,
        f"the link loses more than {100 * LINK_LOSS_MAX:.0f} % of the messages, or likely is silent more than "
        f"{SILENCES_PER_HOUR_MAX:g} times an hour, its radio's buffer is full, or its round trip grows or exceeds "
        f"{LINK_DELAY_MAX_S:g} s",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "move the antenna nearer; land it if the link gets worse",
        reported=lambda status, _: status.link_fault,
        explained_by=(Condition.TELEMETRY_STALE,),
    ),
    Row(
        Condition.BATTERY_WARNING,
        "the autopilot calls a battery low, critical, failed or unhealthy",
        "failsafe.battery_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "return it soon: its charge may be less than it reports",
        reported=lambda status, _: status.battery_fault,
        explained_by=(Condition.BATTERY_CRITICAL, Condition.BATTERY_LOW),
    ),
    Row(
        Condition.STATUS_STALE,
        f"its battery, GPS or estimator has not been reported for {STATUS_STALE_S:g} s",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "land it soon: nothing watches what is not reported",
        reported=lambda status, _: status.stale,
        explained_by=(Condition.TELEMETRY_STALE,),
    ),
    Row(
        Condition.TRAFFIC_NEAR,
        "an aircraft outside the team is nearer than `safety.traffic_distance_m`",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "look for it; land the team if it comes nearer",
    ),
    Row(
        Condition.GIMBAL_FAILED,
        "its camera's gimbal is silent or stuck, or another station controls it",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "fly on without its camera",
        reported=lambda status, _: status.gimbal_fault,
        explained_by=(Condition.TELEMETRY_STALE,),
    ),
    Row(
        Condition.COMPUTER_SHORT,
        f"less than {100 * MEMORY_SHARE_MIN:.0f} % of the computer's memory, {DISK_MIN_BYTES / 1e6:.0f} MB of disk for "
        f"the log, or {100 * (1.0 - DESCRIPTORS_SHARE_MAX):.0f} % of its connections is left",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "free memory, disk or connections: its log may end early",
    ),
    Row(
        Condition.LEADER_LOST,
        "the leader is no longer received, and had not published that it lands or that a pilot flies it; the next in "
        "line leads",
        "failsafe.peer_silent_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "look for the silent vehicle; the next in line leads",
        by_wall=True,
        explained_by=(Condition.BUS_LOST, Condition.PEERS_SILENT),
    ),
    Row(
        Condition.PEER_SILENT,
        "the same for another peer; the others close the gap",
        "failsafe.peer_silent_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "look for it; the others keep clear of it",
        by_wall=True,
        explained_by=(Condition.BUS_LOST, Condition.PEERS_SILENT),
    ),
    Row(
        Condition.PEER_DOUBTFUL,
        f"{CONFIRMED} states of a peer contradict each other, as of two sources; "
        f"lasts until {REPORTED_FOR_S:g} s after the last one",
        "failsafe.doubt_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "count the vehicles in the air; return if one is not in the team",
    ),
    Row(
        Condition.SIGHTINGS_CONTRADICT,
        f"{CONTRADICTED} sightings of a peer or an external source are farther from the own sensor's than their "
        f"covariances allow; lasts until {CONTRADICTS_S:g} s after the last one",
        "failsafe.doubt_s",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "check the sensors: one reports a wrong target position",
        explained_by=(Condition.ESTIMATOR_JUMPED, Condition.ESTIMATOR_FAILING),
    ),
    Row(
        Condition.TARGET_FROM_OUTSIDE,
        "no sensor of the team has seen the target for `target.stale_after_s`, but external sources report it",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "look for the target: no vehicle sees it",
    ),
    Row(
        Condition.STIFFER,
        "it follows its setpoints sooner than its profile predicts; lasts to the landing",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "identify it after the flight (`cordon excite`)",
    ),
    Row(
        Condition.SOFTER,
        "it follows them later",
        "",
        (Reaction.DEGRADE,),
        BY_ITSELF,
        "identify it after the flight (`cordon excite`)",
    ),
    Row(
        Condition.NO_OPERATOR,
        'all operators have left the bus; not checked if `failsafe.no_operator` is "go_on"',
        "failsafe.no_operator_s",
        (Reaction.HOLD, Reaction.RETURN),
        "by `resume`",
        "join its network with an operator's keys, then resume",
        by_wall=True,
        choice="failsafe.no_operator",
        explained_by=(Condition.BUS_LOST,),
    ),
    Row(
        Condition.OPERATOR_LOST,
        "the terminal of `cordon fly` was closed (SIGHUP), or it received SIGTERM or SIGINT",
        "",
        (Reaction.END,),
        NOT_IN_THE_AIR,
        "the team returns and lands: clear the landing places",
        shell=True,
    ),
)
"""Among equally severe conditions the first one in the table is reported."""

_NOTED_FIRST = (Condition.TILTED, Condition.WINDY)
"""Recorded flights note these before the others of the same tick."""
_REPORTED = sorted((row for row in TABLE if row.reported), key=lambda row: row.condition not in _NOTED_FIRST)
_OVERRIDES = {
    Connection.REMOTE_CONTROL: Condition.REMOTE_CONTROL_LOST,
    Connection.GROUND_STATION: Condition.GROUND_STATION_LOST,
    Connection.SETPOINTS: Condition.SETPOINTS_LOST,
    ModeSource.FAILSAFE: Condition.AUTOPILOT_FAILSAFE,
    ModeSource.PILOT: Condition.PILOT_TOOK_OVER,
    ModeSource.STATION: Condition.MODE_CHANGED,
    ModeSource.UNKNOWN: Condition.MODE_CHANGED,
}
"""The condition by what took the vehicle from cordon, the most telling first."""
OVERRIDES = tuple(dict.fromkeys(_OVERRIDES.values()))
ROWS = {row.condition: row for row in TABLE}
_CHOICES = {"hold": Reaction.HOLD, "return": Reaction.RETURN}
POSITION_ALERTS = frozenset(
    each.value
    for each in (
        Condition.TELEMETRY_STALE,
        Condition.ESTIMATOR_JUMPED,
        Condition.ORIGIN_MOVED,
        Condition.ESTIMATOR_FAILING,
        Condition.NOT_FOLLOWING,
        Condition.TILTED,
    )
)
"""The alerts with which a vehicle's position may jump, or its motion be none that its plant allows."""


def reported_faults(status: VehicleStatus, limits: FailsafeSettings) -> dict[Condition, str]:
    """Return the conditions in an autopilot's report, with the detail shown to people."""
    details = ((row.condition, row.reported(status, limits)) for row in _REPORTED if row.reported)
    return {condition: detail for condition, detail in details if detail}


def override(status: VehicleStatus) -> tuple[Condition, str]:
    """Return the condition of a vehicle whose mode or arming cordon did not change, and its detail.

    A lost connection explains more than the source of the change, which may be unknown.
    """
    condition = _OVERRIDES.get(status.lost) or _OVERRIDES[status.mode_by]
    what = f"its mode became '{status.mode.value}'" if status.armed else "it disarmed"
    by = status.mode_by.value or "a pilot, another ground station or its autopilot's failsafe"
    return condition, what if status.lost in _OVERRIDES else f"{what}, by {by}"


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
