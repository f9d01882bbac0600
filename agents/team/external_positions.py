"""Positions of vehicles from outside - motion capture, UWB - as JSON on the team's bus: see docs/indoor.md."""

from collections.abc import Callable
from typing import Annotated

import msgspec

from agents.team.text import printable
from estimation.frames import Triple

TOPIC = "position"
OLD_S, AHEAD_MAX_S = 0.5, 0.1
"""A position that is older than this, or ahead of the clock by more, is refused [wall s]."""
POSES_MAX = 64

_Metre = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]


class ExternalPose(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The position of one vehicle in the mission frame; yaw is counter-clockwise from its x axis, None if unknown."""

    vehicle: int
    position_m: tuple[_Metre, _Metre, _Metre]
    yaw_rad: Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)] | None = None


class ExternalPoses(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Positions of vehicles, measured together at `time_s` [Unix time]; None is the time of reception."""

    poses: Annotated[tuple[ExternalPose, ...], msgspec.Meta(max_length=POSES_MAX)]
    time_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e12)] | None = None


class ExternalPosition(msgspec.Struct, frozen=True):
    """The position of a vehicle at `time_s` [Unix time], in the mission frame."""

    time_s: float
    position_m: Triple
    yaw_rad: float | None


_decoder = msgspec.json.Decoder(ExternalPoses)


class ExternalPositions:
    """Reads the positions of one vehicle; calls `report` for the first refused message."""

    def __init__(self, vehicle_id: int, report: Callable[[str], None]) -> None:
        self._vehicle_id = vehicle_id
        self._report = report
        self.refused = 0

    def take(self, payload: bytes, now_s: float) -> ExternalPosition | None:
        """Return the vehicle's position in a message; None if it has none or is refused.

        `now_s` is Unix time.
        """
        try:
            message = _decoder.decode(payload)
            time_s = now_s if message.time_s is None else message.time_s
            if not -AHEAD_MAX_S <= now_s - time_s <= OLD_S:
                raise ValueError(f"it is {now_s - time_s:.2f} s old")
        except (msgspec.MsgspecError, RecursionError, ValueError) as error:
            self.refused += 1
            if self.refused == 1:
                self._report(printable(f"external position refused, reported once: {error}"))
            return None
        poses = (pose for pose in message.poses if pose.vehicle == self._vehicle_id)
        pose = next(poses, None)
        return None if pose is None else ExternalPosition(time_s, pose.position_m, pose.yaw_rad)
