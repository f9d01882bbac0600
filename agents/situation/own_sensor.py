"""Sightings from peers and outside, checked against the vehicle's own sensor; and which sensors see the target.

While the own sensor sees the target, a sighting of a peer or from outside that contradicts it is refused. False
sightings then cannot move the estimate.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf
from typing import Final

from agents.settings.config import AgentConfig
from agents.team.messages import TOPICS, MemberState
from agents.team.perception import SOURCES_FROM, SOURCES_TO
from estimation.state import Sighting

SEES_S: Final = 1.0
"""Own sightings are compared with others' sightings up to this long before and after them."""
FRAMES_OFF_M: Final = 1.0
"""Standard deviation of the difference between two vehicles' position errors, which covariances of sightings omit."""
CONTRADICTED: Final = 3
_COUNTED_MAX: Final = 6
"""A sensor is reported once this many more of its sightings contradict than agree: a single one may be an outlier."""
CONTRADICTS_S: Final = 5.0
"""How long a sensor stays reported after its last contradiction."""
_OWN_MAX: Final = 64
_PERIOD_S = TOPICS[MemberState].period_s
SIGHTINGS_HZ: Final = 30.0
"""Sightings per second that the team sends in total; the rate of each sensor is also limited by its topic."""
OBSERVES_S: Final = 3.0
"""A sensor counts as seeing the target for this long after its last sighting."""


@dataclass(slots=True)
class Contradiction:
    """A sensor whose sightings contradict the own one: first and last time, and the distance.

    `count` is the number of contradicting sightings less that of agreeing ones. It is `reported` once the count has
    reached `CONTRADICTED`.
    """

    since_s: float
    last_s: float
    count: int
    off_m: float
    reported: bool = False


class OwnSensor:
    """The recent sightings of one target by one vehicle's own sensor, and when each of the team's sensors saw it last.

    Sightings that do not name one of several targets are not compared (`compares`): they may be of different ones.
    """

    def __init__(self, config: AgentConfig, *, compares: bool = True) -> None:
        self._compares = compares
        self._vehicle_id = config.vehicle_id
        self._reach_m_s = config.target_filter.velocity_prior_m_s
        # The gate of the target filter, for two dimensions.
        self._gate = 2.0 * config.target_filter.gate_sigma**2
        self._own: deque[Sighting] = deque(maxlen=_OWN_MAX)
        self._contradictions: dict[int, Contradiction] = {}
        self._observed_s: dict[int, float] = {}
        self._sent_s = self._early_until_s = -inf
        self._early_s = 0.5 / config.rate_hz
        self.team_saw_s = -inf
        """When a sensor of this vehicle or of a peer last saw the target; sensors outside the team do not count."""

    def accepts(self, sighting: Sighting) -> bool:
        """Take a sighting of any sensor; return whether it may be used."""
        time_s, sensor_id = sighting.time_s, sighting.sensor_id
        if sensor_id == self._vehicle_id:
            self._own.append(sighting)
            self._early_until_s = -inf
        elif self._own and self._compares and not self._agrees(sighting):
            return False
        if not SOURCES_FROM <= sensor_id <= SOURCES_TO:
            self._observed_s[sensor_id] = time_s
            self.team_saw_s = max(self.team_saw_s, time_s)
        return True

    def due(self, now_s: float) -> Sequence[Sighting]:
        """Return the newest own sighting once, when it is due to be sent, or all of its time; none otherwise.

        The more sensors see the target, the lower the rate of each: the total information stays the same, and so does
        the load of receivers.
        """
        if not self._own:
            return ()
        newest = self._own[-1]
        since_s = newest.time_s - self._sent_s
        if since_s >= 0.0 and (
            since_s < _PERIOD_S - self._early_s or now_s < self._early_until_s or self._is_early(since_s, now_s)
        ):
            return ()
        self._sent_s, self._early_until_s = newest.time_s, -inf
        return (newest,) if self._compares else [each for each in self._own if each.time_s == newest.time_s]

    def _is_early(self, since_s: float, now_s: float) -> bool:
        """Return whether a time since the last sighting sent is less than the period of each of the sensors that see
        the target.
        """
        observers, early_s, oldest_s = 0, self._early_s, inf
        for seen_s in self._observed_s.values():
            if now_s - seen_s <= OBSERVES_S:
                observers, oldest_s = observers + 1, min(oldest_s, seen_s)
                if since_s < observers / SIGHTINGS_HZ - early_s:
                    self._early_until_s = oldest_s + OBSERVES_S
                    return True
        return False

    def contradictions(self, now_s: float) -> Mapping[int, Contradiction]:
        """Return the sensors that contradict the own one, by their ids."""
        if not self._contradictions:
            return self._contradictions
        self._contradictions = {
            sensor_id: each for sensor_id, each in self._contradictions.items() if now_s - each.last_s <= CONTRADICTS_S
        }
        return {sensor_id: each for sensor_id, each in self._contradictions.items() if each.reported}

    def _agrees(self, sighting: Sighting) -> bool:
        """Return whether another sensor's sighting may be used; the target filter refuses single outliers."""
        off_m = self._contradicted_m(sighting)
        found = self._contradictions.get(sighting.sensor_id)
        if not off_m:
            if found is not None and found.count:
                found.count -= 1
            return True
        if found is None:
            found = self._contradictions[sighting.sensor_id] = Contradiction(sighting.time_s, sighting.time_s, 0, off_m)
        found.last_s, found.off_m = sighting.time_s, off_m
        found.count = min(found.count + 1, _COUNTED_MAX)
        found.reported = found.reported or found.count == CONTRADICTED
        return found.count < CONTRADICTED

    def _contradicted_m(self, sighting: Sighting) -> float:
        """Return the distance of a sighting from the own one nearest in time, 0 if they agree or there is none."""
        own = self._own[-1]
        for earlier in reversed(self._own):
            if abs(earlier.time_s - sighting.time_s) > abs(own.time_s - sighting.time_s):
                break
            own = earlier
        apart_s = abs(own.time_s - sighting.time_s)
        x, y = sighting.position_m[0] - own.position_m[0], sighting.position_m[1] - own.position_m[1]
        # A cheap test that nearly every sighting passes: within the gate for any covariance.
        if apart_s > SEES_S or x * x + y * y <= self._gate * FRAMES_OFF_M**2:
            return 0.0
        spread_m2 = FRAMES_OFF_M**2 + (self._reach_m_s * apart_s) ** 2
        xx, xy, yy = (one + other for one, other in zip(sighting.covariance_m2, own.covariance_m2, strict=True))
        xx, yy = xx + spread_m2, yy + spread_m2
        squared = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
        return hypot(x, y) if squared > self._gate else 0.0


class OwnSensors:
    """The own sensor's sightings of all targets of a mission: one `OwnSensor` for each, and one for those of none."""

    def __init__(self, config: AgentConfig) -> None:
        self._of = {name: OwnSensor(config) for name in config.targets}
        self._of[""] = OwnSensor(config, compares=not config.targets)

    def accepts(self, sighting: Sighting) -> bool:
        """Take a sighting of any sensor; return whether it may be used: not if the mission has no such target."""
        sensor = self._of.get(sighting.target or "")
        return sensor is not None and sensor.accepts(sighting)

    def due(self, now_s: float) -> list[Sighting]:
        """Return the newest own sightings that are due to be sent, each once."""
        return [each for sensor in self._of.values() for each in sensor.due(now_s)]

    def contradictions(self, now_s: float) -> Mapping[int, Contradiction]:
        """Return the sensors that contradict the own one about any target, by their ids."""
        found: dict[int, Contradiction] = {}
        for sensor in self._of.values():
            found |= sensor.contradictions(now_s)
        return found

    def team_saw_s(self, target: str) -> float:
        """Return when a sensor of the team last saw a target, or one that it did not name."""
        return max(self._of[target].team_saw_s, self._of[""].team_saw_s)
