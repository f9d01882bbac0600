"""Messages of sensors outside the team to one vehicle: sightings for its core, and its position for its autopilot."""

import time

from agents.shell.parts import AgentParts
from agents.team import external_positions


class OutsideSensors:
    """Takes payloads on the sensors' topics."""

    def __init__(self, parts: AgentParts) -> None:
        self._parts = parts

    def take(self, topic: str, payload: bytes) -> None:
        """Take one payload; it is dropped if it is neither a sighting nor a position of this vehicle."""
        parts = self._parts
        if topic == external_positions.TOPIC:
            if parts.positions is not None and (position := parts.positions.take(payload, time.time())) is not None:
                parts.link.locate(position)
            return
        seen = parts.perception.take(payload, parts.clock.now_s(), max(parts.clock.time_scale, 1.0))
        if seen is not None:
            parts.core.on_sighting(seen)
