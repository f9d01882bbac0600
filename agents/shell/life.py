"""The life of an agent as a table: from the ground through take-off and flight to the landing.

(phase, event) -> (phase, actions): the shell reports what happens as events and performs the actions in their order.
An event that a phase does not list changes nothing.

The loss of the link is not an event: the core's failsafe holds and then lands the vehicle, and an unanswered call of
the link ends as refused. A restart of the autopilot appears as a flight mode that was not requested.
"""

from enum import Enum

from agents.ports import Connection, FlightMode, VehicleStatus
from agents.tactics import Tactic


class Phase(Enum):
    """The phases of an agent's life."""

    GROUND = "ground"
    COMPARING_CLOCKS = "comparing clocks"
    TAKE_OFF = "take-off"
    HOVERING = "hovering"
    ENTERING_OFFBOARD = "entering offboard"
    AGREEING_START = "start agreement"
    FLYING = "flying"
    STOPPING = "stopping"
    PILOT_OVERRIDE = "pilot override"
    TAKING_BACK = "taking back"
    RETURNING = "returning"
    CHECKING_ARMED = "checking armed"
    LEAVING_OFFBOARD = "leaving offboard"
    LANDING = "landing"
    KILLING = "killing"
    ENDED = "ended"


class LifeEvent(Enum):
    """The events that may change an agent's phase.

    SETPOINT_SENT, TAKEN_OVER, SETPOINTS_LOST and LAND_DECIDED are reported on each tick on which they are true.
    """

    FLY = "fly"
    STAND_BY = "stand by"
    """The vehicle is in reserve: it stays on the ground for another flight."""
    FLY_AGAIN = "fly again"
    """Take off and fly the mission after an earlier flight of the vehicle has ended."""
    ADOPT = "adopt"
    """The vehicle is in the air, and is taken from its autopilot or another ground station."""
    ACCOMPANY = "accompany"
    """The vehicle is in the air, and its pilot keeps it: it is only watched."""
    CLOCKS_AGREE = "clocks agree"
    CLOCKS_DIFFER = "clocks differ"
    TAKE_OFF_DONE = "take-off done"
    TAKE_OFF_REFUSED = "take-off refused"
    SETPOINT_SENT = "setpoint sent"
    OFFBOARD_CONFIRMED = "offboard confirmed"
    OFFBOARD_REFUSED = "offboard refused"
    START_AGREED = "start agreed"
    START_REFUSED = "start refused"
    DURATION_OVER = "duration over"
    OPERATOR_STOP = "stop"
    OPERATOR_HURRY = "second stop"
    HOLD_OVER = "hold over"
    LAND_DECIDED = "land decided"
    TAKEN_OVER = "taken over"
    SETPOINTS_LOST = "setpoints not received"
    """The autopilot's failsafe left offboard for lack of setpoints."""
    RESUME = "resume"
    REJOIN = "rejoin"
    """The vehicle, which its pilot or its autopilot has landed, is to take off again."""
    ARMED = "armed"
    DISARMED = "disarmed"
    OFFBOARD_LEFT = "offboard left"
    OFFBOARD_KEPT = "offboard kept"
    LANDED = "landed"
    LANDING_REFUSED = "landing refused"
    KILL = "kill"
    MOTORS_CUT = "motors cut"
    KILL_REFUSED = "kill refused"
    FAULT = "fault"
    """A task of the agent raised an exception that is not a refusal."""
    ABORTED = "aborted"
    """The flight was cancelled, or a call of the link raised an exception that is not a refusal."""


class Action(Enum):
    """The actions of the shell on a transition."""

    COMPARE_CLOCKS = "compare clocks"
    ADOPT = "adopt"
    """Supervise a vehicle that is in the air, and let the core hold it where it is."""
    TAKE_OFF = "take off"
    ABANDON_TAKE_OFF = "abandon take-off"
    """Wait until an arming in progress has been reported, then check whether the vehicle is armed."""
    START_CONTROL = "start control"
    START_OFFBOARD = "start offboard"
    AGREE_START = "agree on start"
    START_MISSION = "start mission"
    HOLD = "hold"
    END_MISSION = "end mission"
    """Let the core return and land."""
    HAND_OVER = "hand over"
    TAKE_BACK = "take back"
    CHECK_ARMED = "check armed"
    """Stop everything but a kill, and report whether the vehicle is armed."""
    PREPARE_LANDING = "prepare landing"
    """Stop sending setpoints; the core continues to report to peers and operators."""
    STOP_OFFBOARD = "stop offboard"
    LAND = "land"
    CUT_MOTORS = "cut motors"
    REPORT_COMPLETED = "report completed"
    REPORT_STOPPED = "report stopped"
    REPORT_LAND_DECISION = "report land decision"
    REPORT_REFUSAL = "report refusal"
    REPORT_OVERRIDE = "report override"
    REPORT_KILLED = "report killed"
    END_SUPERVISION = "end supervision"
    """Report to the supervisor that the vehicle is down or handed over."""


Transition = tuple[Phase, tuple[Action, ...]]

# The end of a flight: an armed vehicle lands. After an abandoned take-off the arming may be reported later.
_CHECK: Transition = (Phase.CHECKING_ARMED, (Action.CHECK_ARMED,))
_CHECK_REFUSED: Transition = (Phase.CHECKING_ARMED, (Action.REPORT_REFUSAL, Action.CHECK_ARMED))
_CHECK_DECIDED: Transition = (Phase.CHECKING_ARMED, (Action.REPORT_LAND_DECISION, Action.CHECK_ARMED))
_CHECK_STOPPED: Transition = (Phase.CHECKING_ARMED, (Action.REPORT_STOPPED, Action.CHECK_ARMED))
_CHECK_HURRIED: Transition = (
    Phase.CHECKING_ARMED,
    (Action.REPORT_STOPPED, Action.END_MISSION, Action.CHECK_ARMED),
)
_ABANDON_REFUSED: Transition = (Phase.CHECKING_ARMED, (Action.REPORT_REFUSAL, Action.ABANDON_TAKE_OFF))
_ABANDON_STOPPED: Transition = (Phase.CHECKING_ARMED, (Action.REPORT_STOPPED, Action.ABANDON_TAKE_OFF))
_ABANDON_DECIDED: Transition = (Phase.CHECKING_ARMED, (Action.REPORT_LAND_DECISION, Action.ABANDON_TAKE_OFF))
_ABANDON: Transition = (Phase.CHECKING_ARMED, (Action.ABANDON_TAKE_OFF,))
_RETURN_STOPPED: Transition = (Phase.RETURNING, (Action.REPORT_STOPPED, Action.END_MISSION))
# Someone else, or the autopilot itself, has the vehicle.
_OVERRIDE: Transition = (Phase.PILOT_OVERRIDE, (Action.HAND_OVER,))
_LEAVE: Transition = (Phase.ENDED, (Action.REPORT_OVERRIDE, Action.END_SUPERVISION))
_LEAVE_AT_END: Transition = (Phase.ENDED, (Action.END_MISSION, Action.REPORT_OVERRIDE, Action.END_SUPERVISION))
_HAND_OVER: Transition = (Phase.ENDED, (Action.HAND_OVER, Action.REPORT_OVERRIDE, Action.END_SUPERVISION))
_HAND_OVER_AT_END: Transition = (
    Phase.ENDED,
    (Action.HAND_OVER, Action.END_MISSION, Action.REPORT_OVERRIDE, Action.END_SUPERVISION),
)
_KILL: Transition = (Phase.KILLING, (Action.CUT_MOTORS, Action.PREPARE_LANDING))
_WITHOUT_SETPOINTS = (Phase.AGREEING_START, Phase.FLYING, Phase.STOPPING, Phase.RETURNING)
_KILL_IN_LANDING: Transition = (Phase.KILLING, (Action.CUT_MOTORS,))
# The supervisor is not released: it lands the vehicle.
_GIVE_UP: Transition = (Phase.ENDED, ())

TRANSITIONS: dict[tuple[Phase, LifeEvent], Transition] = {
    # The agent still controls the vehicle, which stays in its phase.
    **{(phase, LifeEvent.SETPOINTS_LOST): (phase, (Action.START_OFFBOARD,)) for phase in _WITHOUT_SETPOINTS},
    (Phase.GROUND, LifeEvent.FLY): (Phase.COMPARING_CLOCKS, (Action.COMPARE_CLOCKS,)),
    # Its flight has ended, or it stayed in reserve, and its team still flies.
    (Phase.ENDED, LifeEvent.FLY_AGAIN): (Phase.COMPARING_CLOCKS, (Action.COMPARE_CLOCKS,)),
    # A vehicle in the air needs no take-off; from offboard on it is flown as one that has taken off.
    (Phase.GROUND, LifeEvent.ADOPT): (Phase.HOVERING, (Action.ADOPT, Action.START_CONTROL)),
    (Phase.GROUND, LifeEvent.ACCOMPANY): (
        Phase.PILOT_OVERRIDE,
        (Action.ADOPT, Action.START_CONTROL, Action.HAND_OVER),
    ),
    (Phase.GROUND, LifeEvent.STAND_BY): (Phase.ENDED, ()),
    (Phase.GROUND, LifeEvent.KILL): (Phase.KILLING, (Action.CUT_MOTORS,)),
    (Phase.COMPARING_CLOCKS, LifeEvent.CLOCKS_AGREE): (Phase.TAKE_OFF, (Action.TAKE_OFF,)),
    (Phase.COMPARING_CLOCKS, LifeEvent.CLOCKS_DIFFER): _CHECK_REFUSED,
    (Phase.COMPARING_CLOCKS, LifeEvent.OPERATOR_STOP): _CHECK_STOPPED,
    (Phase.COMPARING_CLOCKS, LifeEvent.KILL): _KILL,
    (Phase.COMPARING_CLOCKS, LifeEvent.FAULT): _CHECK,
    (Phase.COMPARING_CLOCKS, LifeEvent.ABORTED): _CHECK,
    (Phase.TAKE_OFF, LifeEvent.TAKE_OFF_DONE): (Phase.HOVERING, (Action.START_CONTROL,)),
    (Phase.TAKE_OFF, LifeEvent.TAKE_OFF_REFUSED): _ABANDON_REFUSED,
    (Phase.TAKE_OFF, LifeEvent.OPERATOR_STOP): _ABANDON_STOPPED,
    (Phase.TAKE_OFF, LifeEvent.LAND_DECIDED): _ABANDON_DECIDED,
    (Phase.TAKE_OFF, LifeEvent.KILL): _KILL,
    (Phase.TAKE_OFF, LifeEvent.FAULT): _ABANDON,
    (Phase.TAKE_OFF, LifeEvent.ABORTED): _ABANDON,
    # A first stop takes effect once offboard is confirmed: the vehicle then returns as from its mission.
    (Phase.HOVERING, LifeEvent.SETPOINT_SENT): (Phase.ENTERING_OFFBOARD, (Action.START_OFFBOARD,)),
    (Phase.HOVERING, LifeEvent.OPERATOR_HURRY): _CHECK_STOPPED,
    (Phase.HOVERING, LifeEvent.LAND_DECIDED): _CHECK_DECIDED,
    (Phase.HOVERING, LifeEvent.KILL): _KILL,
    (Phase.HOVERING, LifeEvent.FAULT): _CHECK,
    (Phase.HOVERING, LifeEvent.ABORTED): _CHECK,
    # Until offboard is confirmed, the vehicle is in a flight mode that was not requested.
    (Phase.ENTERING_OFFBOARD, LifeEvent.OFFBOARD_CONFIRMED): (Phase.AGREEING_START, (Action.AGREE_START,)),
    (Phase.ENTERING_OFFBOARD, LifeEvent.OFFBOARD_REFUSED): _CHECK_REFUSED,
    (Phase.ENTERING_OFFBOARD, LifeEvent.OPERATOR_HURRY): _CHECK_STOPPED,
    (Phase.ENTERING_OFFBOARD, LifeEvent.LAND_DECIDED): _CHECK_DECIDED,
    (Phase.ENTERING_OFFBOARD, LifeEvent.KILL): _KILL,
    (Phase.ENTERING_OFFBOARD, LifeEvent.FAULT): _CHECK,
    (Phase.ENTERING_OFFBOARD, LifeEvent.ABORTED): _CHECK,
    (Phase.AGREEING_START, LifeEvent.START_AGREED): (Phase.FLYING, (Action.START_MISSION,)),
    (Phase.AGREEING_START, LifeEvent.START_REFUSED): _CHECK_REFUSED,
    (Phase.AGREEING_START, LifeEvent.OPERATOR_STOP): (Phase.STOPPING, (Action.HOLD,)),
    (Phase.AGREEING_START, LifeEvent.LAND_DECIDED): _CHECK_DECIDED,
    (Phase.AGREEING_START, LifeEvent.TAKEN_OVER): _OVERRIDE,
    (Phase.AGREEING_START, LifeEvent.KILL): _KILL,
    (Phase.AGREEING_START, LifeEvent.FAULT): _CHECK,
    (Phase.AGREEING_START, LifeEvent.ABORTED): _CHECK,
    # A vehicle that was taken back continues what went on meanwhile: the start agreement, or the hold of a stop.
    (Phase.FLYING, LifeEvent.START_AGREED): (Phase.FLYING, (Action.START_MISSION,)),
    (Phase.FLYING, LifeEvent.START_REFUSED): _CHECK_REFUSED,
    (Phase.FLYING, LifeEvent.DURATION_OVER): (Phase.RETURNING, (Action.REPORT_COMPLETED, Action.END_MISSION)),
    (Phase.FLYING, LifeEvent.OPERATOR_STOP): (Phase.STOPPING, (Action.HOLD,)),
    (Phase.FLYING, LifeEvent.OPERATOR_HURRY): _CHECK_HURRIED,
    (Phase.FLYING, LifeEvent.HOLD_OVER): _RETURN_STOPPED,
    (Phase.FLYING, LifeEvent.LAND_DECIDED): _CHECK_DECIDED,
    (Phase.FLYING, LifeEvent.TAKEN_OVER): _OVERRIDE,
    (Phase.FLYING, LifeEvent.KILL): _KILL,
    (Phase.FLYING, LifeEvent.FAULT): _CHECK,
    (Phase.FLYING, LifeEvent.ABORTED): _CHECK,
    (Phase.STOPPING, LifeEvent.START_AGREED): (Phase.STOPPING, (Action.START_MISSION,)),
    (Phase.STOPPING, LifeEvent.OPERATOR_HURRY): _CHECK_HURRIED,
    (Phase.STOPPING, LifeEvent.HOLD_OVER): _RETURN_STOPPED,
    (Phase.STOPPING, LifeEvent.LAND_DECIDED): _CHECK_DECIDED,
    (Phase.STOPPING, LifeEvent.TAKEN_OVER): _OVERRIDE,
    (Phase.STOPPING, LifeEvent.KILL): _KILL,
    (Phase.STOPPING, LifeEvent.FAULT): _CHECK,
    (Phase.STOPPING, LifeEvent.ABORTED): _CHECK,
    (Phase.PILOT_OVERRIDE, LifeEvent.RESUME): (Phase.TAKING_BACK, (Action.TAKE_BACK,)),
    (Phase.PILOT_OVERRIDE, LifeEvent.REJOIN): _LEAVE,
    (Phase.PILOT_OVERRIDE, LifeEvent.START_AGREED): (Phase.PILOT_OVERRIDE, (Action.START_MISSION,)),
    (Phase.PILOT_OVERRIDE, LifeEvent.START_REFUSED): _LEAVE,
    (Phase.PILOT_OVERRIDE, LifeEvent.DURATION_OVER): _LEAVE_AT_END,
    (Phase.PILOT_OVERRIDE, LifeEvent.OPERATOR_STOP): (Phase.PILOT_OVERRIDE, (Action.HOLD,)),
    (Phase.PILOT_OVERRIDE, LifeEvent.OPERATOR_HURRY): _LEAVE_AT_END,
    (Phase.PILOT_OVERRIDE, LifeEvent.HOLD_OVER): _LEAVE_AT_END,
    (Phase.PILOT_OVERRIDE, LifeEvent.LAND_DECIDED): _LEAVE,
    (Phase.PILOT_OVERRIDE, LifeEvent.KILL): _KILL,
    (Phase.PILOT_OVERRIDE, LifeEvent.FAULT): _LEAVE,
    (Phase.PILOT_OVERRIDE, LifeEvent.ABORTED): _LEAVE,
    (Phase.TAKING_BACK, LifeEvent.OFFBOARD_CONFIRMED): (Phase.FLYING, ()),
    (Phase.TAKING_BACK, LifeEvent.OFFBOARD_REFUSED): _OVERRIDE,
    (Phase.TAKING_BACK, LifeEvent.START_AGREED): (Phase.TAKING_BACK, (Action.START_MISSION,)),
    (Phase.TAKING_BACK, LifeEvent.START_REFUSED): _HAND_OVER,
    (Phase.TAKING_BACK, LifeEvent.DURATION_OVER): _HAND_OVER_AT_END,
    (Phase.TAKING_BACK, LifeEvent.OPERATOR_STOP): (Phase.TAKING_BACK, (Action.HOLD,)),
    (Phase.TAKING_BACK, LifeEvent.OPERATOR_HURRY): _HAND_OVER_AT_END,
    (Phase.TAKING_BACK, LifeEvent.HOLD_OVER): _HAND_OVER_AT_END,
    (Phase.TAKING_BACK, LifeEvent.LAND_DECIDED): _HAND_OVER,
    (Phase.TAKING_BACK, LifeEvent.KILL): _KILL,
    (Phase.TAKING_BACK, LifeEvent.FAULT): _HAND_OVER,
    (Phase.TAKING_BACK, LifeEvent.ABORTED): _HAND_OVER,
    # An operator may hold a returning vehicle; on resume it continues to return.
    (Phase.RETURNING, LifeEvent.RESUME): (Phase.RETURNING, (Action.END_MISSION,)),
    (Phase.RETURNING, LifeEvent.OPERATOR_HURRY): _CHECK,
    (Phase.RETURNING, LifeEvent.LAND_DECIDED): _CHECK,
    (Phase.RETURNING, LifeEvent.TAKEN_OVER): _HAND_OVER,
    (Phase.RETURNING, LifeEvent.KILL): _KILL,
    (Phase.RETURNING, LifeEvent.FAULT): _CHECK,
    (Phase.RETURNING, LifeEvent.ABORTED): _CHECK,
    (Phase.CHECKING_ARMED, LifeEvent.ARMED): (
        Phase.LEAVING_OFFBOARD,
        (Action.PREPARE_LANDING, Action.STOP_OFFBOARD),
    ),
    (Phase.CHECKING_ARMED, LifeEvent.DISARMED): (Phase.ENDED, (Action.END_SUPERVISION,)),
    (Phase.CHECKING_ARMED, LifeEvent.KILL): _KILL,
    (Phase.CHECKING_ARMED, LifeEvent.ABORTED): _CHECK,
    (Phase.LEAVING_OFFBOARD, LifeEvent.OFFBOARD_LEFT): (Phase.LANDING, (Action.LAND,)),
    (Phase.LEAVING_OFFBOARD, LifeEvent.OFFBOARD_KEPT): (Phase.LANDING, (Action.REPORT_REFUSAL, Action.LAND)),
    (Phase.LEAVING_OFFBOARD, LifeEvent.KILL): _KILL_IN_LANDING,
    (Phase.LEAVING_OFFBOARD, LifeEvent.ABORTED): _GIVE_UP,
    (Phase.LANDING, LifeEvent.LANDED): (Phase.ENDED, (Action.END_SUPERVISION,)),
    (Phase.LANDING, LifeEvent.LANDING_REFUSED): (Phase.ENDED, (Action.REPORT_REFUSAL, Action.END_SUPERVISION)),
    (Phase.LANDING, LifeEvent.KILL): _KILL_IN_LANDING,
    (Phase.LANDING, LifeEvent.ABORTED): _GIVE_UP,
    (Phase.KILLING, LifeEvent.MOTORS_CUT): (Phase.ENDED, (Action.REPORT_KILLED, Action.END_SUPERVISION)),
    (Phase.KILLING, LifeEvent.KILL_REFUSED): (
        Phase.LEAVING_OFFBOARD,
        (Action.REPORT_REFUSAL, Action.STOP_OFFBOARD),
    ),
    (Phase.KILLING, LifeEvent.ABORTED): _GIVE_UP,
    # The flight's result is final; the motors are still cut.
    (Phase.ENDED, LifeEvent.KILL): (Phase.ENDED, (Action.CUT_MOTORS,)),
}


def next_phase(phase: Phase, event: LifeEvent) -> Transition:
    """Return the phase after an event, and the actions to perform; an event not listed for a phase changes nothing."""
    return TRANSITIONS.get((phase, event), (phase, ()))


def is_taken_over(status: VehicleStatus) -> bool:
    """Return whether the flight mode is one that the agent did not request, or the vehicle has disarmed.

    A vehicle that PX4's failsafe landed out of offboard rests in offboard: there only the disarming shows.
    """
    own = status.armed and status.mode in (FlightMode.OFFBOARD, FlightMode.UNKNOWN)
    return status.connected and not own


def without_setpoints(status: VehicleStatus) -> bool:
    """Return whether a vehicle in the air has left offboard only because setpoints did not arrive."""
    return status.lost is Connection.SETPOINTS and status.armed and status.in_air


def resumed(phase: Phase, tactic: Tactic) -> bool:
    """Return whether the core has resumed the mission, by a command of an operator, in a phase without a mission."""
    if phase is Phase.PILOT_OVERRIDE:
        return tactic not in (Tactic.PILOT_OVERRIDE, Tactic.LAND)
    return phase is Phase.RETURNING and tactic in (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.EXCITE)
