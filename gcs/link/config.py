"""The configuration of one vehicle's link, and the pace of each connection of a mission."""

from dataclasses import dataclass, field, replace

from estimation.frames import MissionFrame, Triple
from gcs.autopilots.registry import autopilot_of
from gcs.link.ground_truth import RATE_HZ as TRUTH_HZ
from gcs.link.rates import EXTERNAL_HZ, RateController, Rates
from gcs.mission.mission import LinkSection, Mission, SharedLinkSection, capacity_bytes_s


@dataclass(frozen=True, slots=True)
class LinkConfig:
    """Which vehicle a link connects to (`url`, MAVLink `system_id`), in which mission frame, and the connection's pace.

    In a local frame `origin_m` is where the vehicle's NED begins [m, mission frame]; other frames do not use it.
    `heartbeat_timeout_s` limits the search for the vehicle and is wall time. `ready_timeout_s` limits the waits for its
    position and for its arming checks and is time of the mission clock. With a `signing_key` (32 bytes) every message
    to and from the vehicle is signed. With `truth` a simulator's true motion is requested. With
    `external_positions` its autopilot receives external positions. `view_rad` is the angle of view of a camera whose
    gimbal is pointed, None without one. With `traffic` the aircraft that it hears are requested.
    """

    url: str
    system_id: int
    frame: MissionFrame
    pace: RateController = field(default_factory=lambda: RateController(full_rates(LinkSection(), 20.0)))
    origin_m: Triple = (0.0, 0.0, 0.0)
    heartbeat_timeout_s: float = 10.0
    ready_timeout_s: float = 60.0
    signing_key: bytes | None = field(default=None, repr=False)
    truth: bool = False
    external_positions: bool = False
    view_rad: float | None = None
    traffic: bool = False


def full_rates(link: LinkSection, loop_hz: float) -> Rates:
    """Return the rates of `[link]`; setpoints are sent at most once per tick."""
    setpoint_hz = min(link.setpoint_rate_hz or loop_hz, loop_hz)
    return Rates(link.telemetry_rate_hz, link.status_rate_hz, setpoint_hz, link.attitude_rate_hz)


def link_paces(mission: Mission, *, truth: bool = False) -> dict[str, RateController]:
    """Return the pace of each connection, by its url; with `truth` simulators' true motions are requested."""
    link, vehicles = mission.link, mission.vehicles
    shared = {each.url: each for each in mission.links.values()}
    full = full_rates(link, mission.mission.rate_hz)

    def pace(url: str) -> RateController:
        own = shared.get(url) or SharedLinkSection(url=url)
        capacity = capacity_bytes_s(url, own.bytes_per_s or link.bytes_per_s)
        carried = [vehicle for vehicle in vehicles if vehicle.section.url == url]
        return RateController(
            # More attitudes would fill a slow connection and arrive late, and the clock would appear fast.
            full if capacity is None else replace(full, clock_hz=full.status_hz),
            len(carried),
            capacity,
            automatic=(own.rates or link.rates) == "auto",
            signed=link.signing_key_file is not None,
            limits_setpoints=link.setpoint_rate_hz is not None,
            positions_hz=EXTERNAL_HZ if mission.frame.external_positions else 0.0,
            gimbals=sum(each.section.gimbal is not None for each in carried),
            telemetry_s=mission.safety.telemetry_timeout_s,
            offboard_s=min(autopilot_of(each.autopilot).setpoint_timeout_s({}) for each in carried),
            truth_bytes_s=sum(TRUTH_HZ * autopilot_of(each.autopilot).truth.size_bytes for each in carried if truth),
        )

    return {url: pace(url) for url in {vehicle.section.url for vehicle in vehicles}}
