"""Fault detection: which conditions of the failsafe table are present, and since when."""

from collections.abc import Container, Iterable, Mapping
from math import hypot, inf
from typing import Final

from agents.drops import NO_DROPS
from agents.notes import ReferenceChange
from agents.safety.failsafe import Condition
from agents.safety.failsafe_monitor import COUNTED_SHARE, Symptom
from agents.safety.fence import Area
from agents.safety.neighbours import GOING_ON_S
from agents.safety.vehicle_watch import VehicleWatch
from agents.settings.config import AgentConfig
from agents.situation.estimator import Estimator
from agents.situation.own_sensor import OwnSensors
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.clock_watch import ClockWatch
from agents.team.perception import SOURCES_FROM
from agents.team.team import Team

COMPARED_S: Final = 1.0
"""The period at which clocks are checked for a slow drift."""
SAME_HEIGHT_M: Final = 1.0
"""Vehicles whose heights differ by less than this, or than half a layer, are at the same height."""
_FLOOD_ENDS: Final = 0.8
_JUMPED = "position jumped"
_TARGET_STALE: Final = Condition.TARGET_STALE
_ON_A_RING = (Tactic.ENCIRCLE, Tactic.TRANSIT)
_IN_COMPANY = (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.EXCITE, Tactic.ASIDE, Tactic.HOLD)
"""During take-off and return vehicles are separated by layers and in time, and may be near each other."""

Faults = dict[Condition, Symptom]


class FaultDetector:
    """Watches one vehicle, its estimates and its team; the core sets the state of vehicle, loop, bus and solvers."""

    def __init__(
        self, config: AgentConfig, estimator: Estimator, own_sensors: OwnSensors, team: Team, clocks: ClockWatch
    ) -> None:
        self._settings = config.failsafe
        self._leader = config.formation.leader
        self._awaited = len(config.slots) - 1
        self._period_s = 1.0 / config.rate_hz
        # Without the guard separation is not kept: simulations that demonstrate this must not be interrupted.
        self._near_m = config.failsafe.separation_share * config.safety.separation_m if config.safety.guard else 0.0
        layer_m = config.choreography.layer_m
        self._same_height_m = min(SAME_HEIGHT_M, layer_m / 2.0) if layer_m else SAME_HEIGHT_M
        self._lost_avoided_s = config.safety.lost_avoided_s
        self._stale_after_s = config.target_filter.stale_after_s
        self._own, self._targets, self._own_sensors = estimator.own, estimator.targets, own_sensors
        self._team, self._clocks = team, clocks
        settle_s = config.failsafe.settle_s
        self._own_jumps, self._target_jumps, self._moves = _Jumps(settle_s), _Jumps(settle_s), _Jumps(settle_s)
        self.origin_moves = 0
        self._since_s: dict[Condition, float] = {}
        self._compare_s, self._drifted_s = -inf, dict[int, float]()
        self._area = Area(config.safety)
        self._is_bounded = bool(config.safety.fence_m or config.safety.no_fly)
        self.vehicle = VehicleWatch(config, self._own)
        self.late_ticks = 0
        self.bus_alive = True
        self.operated = False
        self._operators_needed, self._was_operated = config.failsafe.no_operator != "go_on", False
        self.bus_drops = NO_DROPS
        self._flood = _Flood(config.failsafe.flood_per_s)
        self.unsolved = False
        self.computer_short_of = ""
        self.traffic_near = ""

    def join(self) -> None:
        """Take that the vehicle joins others in flight: those of them that are down are never received."""
        self._awaited = min(self._awaited, 1)

    def detect(self, situation: Situation, tactic: Tactic, active: Container[Condition], time_scale: float) -> Faults:
        """Return the faults of this tick.

        `active` are the conditions with a reaction: some of them persist while they hold the vehicle. `time_scale` is
        mission seconds per wall second.
        """
        faults: Faults = {}
        now_s = situation.now_s
        self._check_vehicle(faults, now_s)
        if present := self.vehicle.faults(situation, tactic):
            for condition, detail in present.items():
                self._add(faults, now_s, condition, detail)
        self._check_loop(faults, now_s)
        self._check_flood(faults, now_s, time_scale)
        self._check_target(faults, situation, tactic, active)
        inconsistencies = self._team.inconsistencies
        if gone_s := self._team.gone_s:
            self._check_peers(faults, gone_s, inconsistencies)
        if self._clocks.off or self._drifted_s or now_s >= self._compare_s:
            self._check_clocks(faults, now_s, time_scale)
        if inconsistencies:
            since_s = min(inconsistency.since_s for inconsistency in inconsistencies.values())
            detail = ", ".join(
                f"vehicle {sender} {inconsistency.why}" for sender, inconsistency in sorted(inconsistencies.items())
            )
            faults[Condition.PEER_DOUBTFUL] = Symptom(since_s, detail)
        x, y = situation.own.mean.item(0), situation.own.mean.item(1)
        if self._is_bounded:
            self._check_area(faults, now_s, x, y, situation.height_m)
        if tactic in _IN_COMPANY:
            self._check_distances(faults, now_s, x, y, situation.height_m)
        if self._since_s:
            for condition in [c for c in self._since_s if c not in faults]:
                del self._since_s[condition]
        return faults

    def _add(self, faults: Faults, now_s: float, condition: Condition, detail: str) -> None:
        faults[condition] = Symptom(self._since_s.setdefault(condition, now_s), detail)

    def _check_area(self, faults: Faults, now_s: float, x: float, y: float, height_m: float) -> None:
        area = self._area
        if area.fence is not None and not area.fence.contains((x, y)):
            self._add(faults, now_s, Condition.FENCE_LEFT, f"at ({x:.1f}, {y:.1f}) m")
        if (zone := area.entered((x, y), height_m)) is not None:
            self._add(faults, now_s, Condition.ZONE_ENTERED, f"'{zone.name}', at ({x:.1f}, {y:.1f}, {height_m:.1f}) m")

    def _check_vehicle(self, faults: Faults, now_s: float) -> None:
        received_s = self._own.received_s
        if received_s is not None and now_s - received_s > self._period_s:
            faults[Condition.TELEMETRY_STALE] = Symptom(received_s, f"none for {now_s - received_s:.1f} s")
        jumped_s = self._own_jumps.see(self._own.jumps, now_s)
        if jumped_s is not None:
            reference = self.vehicle.status.reference
            detail = ReferenceChange("position jumped", *reference.jumped_m).by if reference.jumps else _JUMPED
            faults[Condition.ESTIMATOR_JUMPED] = Symptom(jumped_s, detail)
        moved_s = self._moves.see(self.origin_moves, now_s)
        if moved_s is not None:
            moved = ReferenceChange("origin moved", *self.vehicle.status.reference.moved_m)
            faults[Condition.ORIGIN_MOVED] = Symptom(moved_s, moved.by)
        battery = self.vehicle.status.battery
        if battery is not None and battery < self._settings.battery_low:
            self._add(faults, now_s, Condition.BATTERY_LOW, f"at {battery:.0%}")
            if battery < self._settings.battery_critical:
                self._add(faults, now_s, Condition.BATTERY_CRITICAL, f"at {battery:.0%}")

    def _check_loop(self, faults: Faults, now_s: float) -> None:
        if self.unsolved:
            self._add(faults, now_s, Condition.PLAN_FAILING, "no solution within the bounds")
        if self.late_ticks:
            self._add(faults, now_s, Condition.LATE_TICKS, "the control loop does not keep its rate")
        if self.computer_short_of:
            self._add(faults, now_s, Condition.COMPUTER_SHORT, self.computer_short_of)
        if self.traffic_near:
            self._add(faults, now_s, Condition.TRAFFIC_NEAR, self.traffic_near)
        if not self.bus_alive:
            self._add(faults, now_s, Condition.BUS_LOST, "the Zenoh session is closed")
        if self.operated:
            self._was_operated = True
        elif self._was_operated and self._operators_needed:
            self._add(faults, now_s, Condition.NO_OPERATOR, "all operators have left the bus")

    def _check_flood(self, faults: Faults, now_s: float, time_scale: float) -> None:
        if self._flood.see(self.bus_drops.refused, now_s, time_scale):
            self._add(faults, now_s, Condition.BUS_FLOODED, self.bus_drops.text())

    def _check_target(self, faults: Faults, situation: Situation, tactic: Tactic, active: Container[Condition]) -> None:
        on_ring, sighted_s = tactic in _ON_A_RING, self._targets.sighted_s
        fading = on_ring and situation.now_s - sighted_s > COUNTED_SHARE * self._stale_after_s
        if fading or (situation.target is None and (on_ring or _TARGET_STALE in active)):
            faults[Condition.TARGET_STALE] = Symptom(sighted_s, f"not seen for {situation.now_s - sighted_s:.1f} s")
        jumped_s = self._target_jumps.see(self._targets.resets, situation.now_s, new=on_ring)
        if jumped_s is not None:
            faults[Condition.TARGET_JUMPED] = Symptom(jumped_s, "all sightings disagree with the estimate")
        saw_s = self._own_sensors.team_saw_s(self._targets.followed)
        if situation.target is not None and situation.now_s - saw_s > self._stale_after_s:
            self._add(faults, situation.now_s, Condition.TARGET_FROM_OUTSIDE, "no sensor of the team sees it")
        if not (contradictions := self._own_sensors.contradictions(situation.now_s)):
            return
        if contradictions := {i: each for i, each in contradictions.items() if not self._team.explanation(i)}:
            since_s = min(each.since_s for each in contradictions.values())
            detail = ", ".join(f"{_sensor(i)} by {each.off_m:.1f} m" for i, each in sorted(contradictions.items()))
            faults[Condition.SIGHTINGS_CONTRADICT] = Symptom(since_s, detail)

    def _check_peers(self, faults: Faults, gone_s: Mapping[int, float], doubtful: Container[int]) -> None:
        if not self._team.members() and self._team.count_received >= self._awaited:
            faults[Condition.PEERS_SILENT] = Symptom(max(gone_s.values()), _vehicles(gone_s))
        # One whose states are refused is not silent but doubtful.
        gone_s = {sender: received_s for sender, received_s in gone_s.items() if sender not in doubtful}
        if self._leader in gone_s:
            faults[Condition.LEADER_LOST] = Symptom(gone_s[self._leader], f"vehicle {self._leader}")
        followers_s = {sender: received_s for sender, received_s in gone_s.items() if sender != self._leader}
        if followers_s:
            faults[Condition.PEER_SILENT] = Symptom(min(followers_s.values()), _vehicles(followers_s))

    def _check_clocks(self, faults: Faults, now_s: float, time_scale: float) -> None:
        if now_s >= self._compare_s:
            self._compare_s, self._drifted_s = now_s + COMPARED_S, self._clocks.drifted(now_s)
        if self._drifted_s:
            self._add(faults, now_s, Condition.CLOCK_DRIFTED, _offsets(self._drifted_s))
        stepped = self._clocks.stepped(now_s, time_scale)
        if stepped:
            since_s = min(step.since_s for step in stepped.values())
            by_s = {sender: step.by_s for sender, step in stepped.items()}
            faults[Condition.CLOCK_STEPPED] = Symptom(since_s, _offsets(by_s))

    def _check_distances(self, faults: Faults, now_s: float, x: float, y: float, height_m: float) -> None:
        near_m, nearest = self._near_m, 0
        for peer in self._team.near_numbers():
            age_s = now_s - peer.time_s
            away_x = peer.position_m[0] + peer.velocity_m_s[0] * age_s - x
            # A cheap test that decides nearly always.
            if -near_m < away_x < near_m and abs(peer.altitude_m - height_m) < self._same_height_m:
                away_m = hypot(away_x, peer.position_m[1] + peer.velocity_m_s[1] * age_s - y)
                if away_m < near_m:
                    near_m, nearest = away_m, peer.sender
        for member in self._team.lost(now_s, self._lost_avoided_s):
            peer = member.numbers
            ahead_s = min(now_s - peer.time_s, GOING_ON_S)
            away_x = peer.position_m[0] + peer.velocity_m_s[0] * ahead_s - x
            away_m = hypot(away_x, peer.position_m[1] + peer.velocity_m_s[1] * ahead_s - y)
            if away_m < near_m and abs(peer.altitude_m - height_m) < self._same_height_m:
                near_m, nearest = away_m, peer.sender
        if nearest:
            self._add(faults, now_s, Condition.TOO_CLOSE, f"{near_m:.2f} m from vehicle {nearest}")


class _Jumps:
    """A filter's resets as a condition that lasts until no reset has occurred for some time."""

    def __init__(self, settle_s: float) -> None:
        self._settle_s = settle_s
        self._seen = 0
        self._since_s: float | None = None
        self._last_s = -inf

    def see(self, resets: int, now_s: float, *, new: bool = True) -> float | None:
        """Return when the jumps began, None if there are none; only with `new` a reset begins or prolongs them."""
        if resets == self._seen and self._since_s is None:
            return None
        if resets != self._seen:
            self._seen = resets
            if new:
                self._last_s = now_s
                self._since_s = now_s if self._since_s is None else self._since_s
        if self._since_s is not None and now_s - self._last_s >= self._settle_s:
            self._since_s = None
        return self._since_s


class _Flood:
    """Whether messages are refused faster than a limit: a leaky bucket of the size that the limit allows in one second.

    The flood begins when it is full and ends when it is a fifth empty.
    """

    def __init__(self, limit_per_s: float) -> None:
        self._limit_per_s = limit_per_s
        self._level = 0.0
        self._counted: int | None = None
        self._at_s = 0.0
        self._flooded = False

    def see(self, refused: int, now_s: float, time_scale: float) -> bool:
        """Take the total count so far; `time_scale` is mission seconds per wall second."""
        if self._counted is not None:
            leaked = self._limit_per_s * (now_s - self._at_s) / time_scale
            self._level = min(max(self._level + refused - self._counted - leaked, 0.0), self._limit_per_s)
        self._counted, self._at_s = refused, now_s
        self._flooded = self._level >= (_FLOOD_ENDS if self._flooded else 1.0) * self._limit_per_s
        return self._flooded


def _sensor(sensor_id: int) -> str:
    return f"vehicle {sensor_id}" if sensor_id < SOURCES_FROM else f"source {sensor_id - SOURCES_FROM}"


def _vehicles(ids: Iterable[int]) -> str:
    return ", ".join(f"vehicle {each}" for each in sorted(ids))


def _offsets(by_s: dict[int, float]) -> str:
    return ", ".join(f"vehicle {sender} by {ahead_s:+.2f} s" for sender, ahead_s in sorted(by_s.items()))
