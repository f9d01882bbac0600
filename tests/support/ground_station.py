"""A ground station that knows nothing of a stub but its bytes, without sockets."""

from typing import Any

from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import StubAutopilot
from sitl.faults import VehicleFaults
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink.reports import MavlinkConfig


class GroundStation:
    """Sends messages of a dialect of pymavlink's to one stub, and reads what it answers and sends as time passes."""

    def __init__(
        self, autopilot: StubAutopilot, config: MavlinkConfig, dialect: Any, faults: VehicleFaults | None = None
    ) -> None:
        self.vehicle = MavlinkVehicle(autopilot, config, faults=faults)
        self._autopilot, self._system_id, self._dialect = autopilot, config.system_id, dialect
        self._writer, self._reader = dialect.MAVLink(None, 245, 190), dialect.MAVLink(None)

    def run(self, seconds: float) -> list[Any]:
        """Let simulated time pass and return everything sent meanwhile."""
        messages: list[Any] = []
        step = round(self._autopilot.time_s / STEP_S)
        for number in range(1, 1 + round(seconds / STEP_S)):
            self._autopilot.step((step + number) * STEP_S)
            messages += self._read(self.vehicle.emit(self._autopilot.time_s))
        return messages

    def send(self, message: Any) -> list[Any]:
        """Send a message and return the answers."""
        return self._read(self.vehicle.receive(self.pack(message), self._autopilot.time_s))

    def pack(self, message: Any) -> bytes:
        """Return the bytes of the next message."""
        return bytes(message.pack(self._writer))

    def command(self, command: int, *params: float, target: int | None = None) -> list[Any]:
        """Send a command, to this vehicle unless told otherwise, and return the answers."""
        to = self._system_id if target is None else target
        return self.send(self._dialect.MAVLink_command_long_message(to, 1, command, 0, *(*params, *[0.0] * 7)[:7]))

    def _read(self, packets: list[bytes]) -> list[Any]:
        return [message for packet in packets for message in self._reader.parse_buffer(packet) or []]
