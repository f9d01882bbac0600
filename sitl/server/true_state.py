"""The true state of one stub vehicle at one time."""

from dataclasses import dataclass

from estimation.frames import Triple


@dataclass(frozen=True, slots=True)
class TrueState:
    """The true state of a stub vehicle, without the noise and the faults of its estimate.

    `position_m` and `velocity_m_s` are in the mission frame: x and y horizontal, z up. `ned_m` and `ned_m_s` are the
    same in the vehicle's own local frame, north, east, down, as in MAVLink's LOCAL_POSITION_NED. `mode` is a flight
    mode of PX4 such as "Hold", "Takeoff", "Offboard", "Return" or "Land", also of an ArduPilot vehicle: GUIDED is
    "Offboard". `time_s` is the simulated time since the vehicles booted.
    """

    time_s: float
    position_m: Triple
    velocity_m_s: Triple
    ned_m: Triple
    ned_m_s: Triple
    armed: bool
    mode: str

    def __str__(self) -> str:
        x, y, z = self.position_m
        armed = "armed" if self.armed else "disarmed"
        return f"{armed}, mode {self.mode}, at ({x:.2f}, {y:.2f}, {z:.2f}) m after {self.time_s:.2f} s"
