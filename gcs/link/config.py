"""The configuration of one vehicle's link."""

from dataclasses import dataclass, field

from estimation.frames import MissionFrame, Triple
from gcs.mission.mission import LinkSection


@dataclass(frozen=True, slots=True)
class LinkConfig:
    """Which vehicle a link connects to (`url`, MAVLink `system_id`), in which mission frame, and its rates.

    In a local frame `origin_m` is where the vehicle's NED begins [m, mission frame]; other frames do not use it.
    `heartbeat_timeout_s` limits the search for the vehicle and is wall time. `ready_timeout_s` limits the waits for its
    position and for its arming checks and is time of the mission clock. With a `signing_key` (32 bytes) every message
    to and from the vehicle is signed. With `truth` a simulated vehicle is asked for its true motion.
    """

    url: str
    system_id: int
    frame: MissionFrame
    settings: LinkSection = field(default_factory=LinkSection)
    origin_m: Triple = (0.0, 0.0, 0.0)
    heartbeat_timeout_s: float = 10.0
    ready_timeout_s: float = 60.0
    signing_key: bytes | None = field(default=None, repr=False)
    truth: bool = False
