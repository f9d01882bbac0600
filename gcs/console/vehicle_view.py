"""A vehicle as an onlooker sees it: the one type that the terminals' tables and the operator's page show."""

from collections.abc import Mapping, Sequence
from math import ceil, hypot, inf, isfinite
from typing import TypeVar

import msgspec
from msgspec.structs import replace

from agents.notes import GuardAction
from agents.safety.failsafe import Condition
from agents.safety.fence import Area
from agents.team.messages import RESUMES, AutopilotReport, MemberState, Outlook, VehicleReport
from estimation.frames import Triple
from gcs.console.advice import Severity, advice, severity
from gcs.console.rings import chosen_ring
from gcs.metrics.ending import SEARCH, UNACCOUNTED, Unaccounted
from gcs.mission.geometry import nearest_other

Pair = tuple[float, float]
RESERVE = "reserve"
"""Shown in place of the tactic of a vehicle in reserve."""
SILENT, LINK_CUT, WAITS = "silent", "link cut", "waits for resume"
PAST_S = 2.0
"""A change that has been due for so long without a report of it is no longer shown."""
_ADVISED_AS = {SILENT: Condition.PEER_SILENT.value, LINK_CUT: Condition.TELEMETRY_STALE.value}


class NextView(msgspec.Struct, frozen=True):
    """What a vehicle `does` by itself next ("lands"), after `in_s`, because of its `cause`."""

    does: str
    in_s: float
    cause: str


class VehicleView(msgspec.Struct, frozen=True):
    """One vehicle at one time. `age_s` is the age of its last message [wall s], None before the first.

    `is_stale` means that its position is out of date: its messages stopped, or its link is cut. `mode` is empty without
    a link. `aim_m` is the undisturbed aim, which its peers receive, `setpoint_m` the setpoint sent, which a log holds;
    `yaw_rad` is that of the setpoint. `link_age_s` is how long its agent has received nothing from its autopilot.
    `is_unaccounted` means that its flight has ended, and no report, pilot or operator accounts for it: its position is
    the last one known.
    `nearest_m` is the horizontal distance to the nearest other flying vehicle, `fence_margin_m` that to the fence
    (negative: outside). `advice` is the operator's action for the alert. `blocks` is the condition that refuses a
    resume, `also` are its other conditions, `guard` is why its aim is bent. `ending` is how its flight ended,
    empty before; one `in_reserve` has not flown yet, and stays on the ground. `ring` is the name of the ring that it is
    on or flies to; it is unset in a mission of one ring.
    Unknown values are None, or empty.
    """

    vehicle_id: int
    age_s: float | None = None
    is_stale: bool = True
    has_ended: bool = False
    tactic: str = ""
    mode: str = ""
    position_m: Triple | None = None
    yaw_rad: float | None = None
    velocity_m_s: Pair | None = None
    aim_m: Pair | None = None
    setpoint_m: Pair | None = None
    autopilot: AutopilotReport = AutopilotReport()
    estimator: str = ""
    link_age_s: float | None = None
    nearest_id: int | None = None
    nearest_m: float | None = None
    fence_margin_m: float | None = None
    radius_m: float | None = None
    angular_rate_rad_s: float | None = None
    lead_rad: float | None = None
    alert: str = ""
    advice: str = ""
    severity: Severity = "information"
    next: NextView | None = None
    blocks: str = ""
    also: tuple[str, ...] = ()
    waits_for_resume: bool = False
    guard: str = ""
    ending: str = ""
    is_unaccounted: bool = False
    in_reserve: bool = False
    ring: str | msgspec.UnsetType = msgspec.UNSET

    @property
    def over(self) -> str:
        """The word for a vehicle whose flight has ended, or which is in reserve."""
        return RESERVE if self.in_reserve else "ended"

    @property
    def due(self) -> str:
        """What it does next, what refuses its resume, its other alerts: "lands in 18 s; also link degraded"."""
        texts = []
        if self.next is not None:
            cause = f" ({self.next.cause})" if self.next.cause != self.alert else ""
            texts.append(f"{self.next.does} in {ceil(self.next.in_s)} s{cause}")
        if self.blocks not in ("", self.alert):
            texts.append(f"resume refused: {self.blocks}")
        if others := ", ".join(each for each in self.also if each != self.blocks):
            texts.append(f"also {others}" if self.alert else others)
        return "; ".join(texts)

    @property
    def height_m(self) -> float | None:
        """The height above the mission's origin."""
        return None if self.position_m is None else self.position_m[2]

    @property
    def speed_m_s(self) -> float | None:
        """The speed over ground."""
        return None if self.velocity_m_s is None else hypot(*self.velocity_m_s)


class TeamRow(VehicleView, frozen=True):
    """A vehicle in a terminal's table: what only the process that flies it knows as well, and a note below the table.

    `gps_threat` names what disturbs its GPS, `lag_rad` is the angle to the vehicle behind on the ring, `round_trip_s`
    the time from a message to its answer [wall s].
    """

    note: str = ""
    gps_threat: str = ""
    lag_rad: float | None = None
    round_trip_s: float | None = None


ViewT = TypeVar("ViewT", bound=VehicleView)


def with_state(view: ViewT, state: MemberState, rings: Sequence[str] = ()) -> ViewT:
    """Return a view with what a vehicle's state holds; `rings` are the names of the mission's, none if it has one."""
    angle = state.angle
    return replace(
        view,
        tactic=state.tactic,
        position_m=(*state.position_m, state.altitude_m),
        velocity_m_s=state.velocity_m_s,
        aim_m=state.aim_m,
        radius_m=None if angle is None else angle.radius_m,
        angular_rate_rad_s=None if angle is None else angle.angular_rate_rad_s,
        ring=chosen_ring(state, rings) if rings else msgspec.UNSET,
    )


def with_report(view: ViewT, report: VehicleReport, age_s: float, now_s: float) -> ViewT:
    """Return a view with what a vehicle's report holds; it was received `age_s` ago, `now_s` is the team's clock."""
    silent_s = age_s if report.is_link_cut else 0.0
    return replace(
        with_outlook(view, report.outlook, now_s),
        mode=report.mode,
        in_reserve=bool(report.in_reserve),
        position_m=report.position_m if view.position_m is None else view.position_m,
        yaw_rad=report.yaw_rad,
        autopilot=report.autopilot,
        estimator=report.estimator,
        link_age_s=None if report.link_age_s is None else report.link_age_s + silent_s,
    )


def with_outlook(view: ViewT, outlook: Outlook | None, now_s: float) -> ViewT:
    """Return a view with what holds a vehicle and what it does next, at a time on the team's clock."""
    if outlook is None:
        return view
    change = outlook.next
    is_past = change is None or now_s - change.at_s > PAST_S
    return replace(
        view,
        next=None if change is None or is_past else NextView(change.does, max(change.at_s - now_s, 0.0), change.cause),
        blocks=outlook.blocks,
        also=outlook.also,
        waits_for_resume=outlook.waits_for_resume,
        guard=GuardAction(outlook.guard, outlook.evaded).text,
    )


def may_fly(report: VehicleReport | None) -> bool:
    """Return whether a vehicle whose flight has not ended is in the air by its newest report, or may be without one."""
    return report is None or report.armed or report.in_air


def with_alert(view: ViewT, alert: str, *, is_lost: bool = False) -> ViewT:
    """Return a view with an alert, its advice and severity; of a vehicle that `is_lost` in flight it is an alarm.

    An alert that is over is one that the vehicle waits for a resume.
    """
    if alert and view.waits_for_resume and not is_lost:
        if view.next is not None and view.next.does == RESUMES:
            return replace(view, alert=WAITS, advice="hold it if it must not continue its mission", severity="warning")
        return replace(view, alert=WAITS, advice=f"{alert} is over: resume continues its mission", severity="alarm")
    level: Severity = "alarm" if alert and is_lost else severity(alert)
    return replace(view, alert=alert, advice=advice(_ADVISED_AS.get(alert, alert)), severity=level)


def with_unaccounted(view: ViewT, lost: Unaccounted | None = None) -> ViewT:
    """Return a view of a vehicle that is unaccounted for; for a terminal the advice says where it was `lost`."""
    return replace(
        view,
        position_m=view.position_m if lost is None else lost.position_m,
        is_stale=True,
        has_ended=False,
        is_unaccounted=True,
        alert=UNACCOUNTED,
        advice=SEARCH if lost is None else f"{lost.place}: search there",
        severity="alarm",
    )


def with_surroundings(view: ViewT, places_m: Mapping[int, Pair], areas: Mapping[int, Area]) -> ViewT:
    """Return a view with the distances to the others, of which `places_m` are the positions, and to its limits."""
    nearest_id, nearest_m = nearest_other(view.vehicle_id, places_m) or (None, None)
    area, place_m = areas.get(view.vehicle_id), places_m.get(view.vehicle_id)
    height_m = 0.0 if view.position_m is None else view.position_m[2]
    margin_m = inf if area is None or place_m is None else area.clearance_m(place_m, height_m)
    return replace(
        view, nearest_id=nearest_id, nearest_m=nearest_m, fence_margin_m=margin_m if isfinite(margin_m) else None
    )
