"""An attacker that sends MAVLink with a vehicle's system id from its own address, and counts what it receives."""

import socket
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

LOOPBACK = "127.0.0.1"
AUTOPILOT, PX4 = 1, 12
QUADROTOR, ACTIVE = 2, 4
ARMED_CUSTOM, POSCTL = 128 | 1, 3 << 16
DISARM_FORCE = 21196


class Forger:
    """Sends as the autopilot `system_id`; with a key it signs, as a vehicle with that key would."""

    def __init__(self, system_id: int, key: bytes | None = None, host: str = LOOPBACK, port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._socket.setblocking(False)
        self._mavlink = mavlink.MAVLink(None, system_id, AUTOPILOT)
        if key is not None:
            self._mavlink.signing.secret_key = key
            self._mavlink.signing.sign_outgoing = True
            self._mavlink.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)

    @property
    def address(self) -> str:
        """Its address as text."""
        host, port = self._socket.getsockname()
        return f"{host}:{port}"

    def heartbeat(self, port: int, mode: int = POSCTL) -> None:
        """Send another flight mode, in which a pilot has control."""
        self._send(mavlink.MAVLink_heartbeat_message(QUADROTOR, PX4, ARMED_CUSTOM, mode, ACTIVE, 3), port)

    def position(self, port: int, north_m: float) -> None:
        """Send a position in the vehicle's own frame."""
        self._send(mavlink.MAVLink_local_position_ned_message(1000, north_m, 0.0, -5.0, 0.0, 0.0, 0.0), port)

    def disarm(self, target: int, port: int) -> None:
        """Send the command to cut the motors to a vehicle's own port."""
        self._arm(target, port, 0.0, DISARM_FORCE)

    def arm(self, target: int, port: int) -> None:
        """Send the command to arm to a vehicle's own port."""
        self._arm(target, port, 1.0, 0)

    def garbage(self, port: int) -> None:
        """Send what is no message."""
        self.replay(b"garbage", port)

    def replay(self, frame: bytes, port: int) -> None:
        """Send a frame that somebody else has sent."""
        self._socket.sendto(frame, (LOOPBACK, port))

    def _arm(self, target: int, port: int, arms: float, force: int) -> None:
        self._send(mavlink.MAVLink_command_long_message(target, 1, 400, 0, arms, force, 0, 0, 0, 0, 0), port)

    def received(self) -> int:
        """Return the number of datagrams received."""
        count = 0
        try:
            while True:
                self._socket.recv(65535)
                count += 1
        except BlockingIOError:
            return count

    def close(self) -> None:
        """Close its socket."""
        self._socket.close()

    def _send(self, message: mavlink.MAVLink_message, port: int) -> None:
        self._socket.sendto(message.pack(self._mavlink), (LOOPBACK, port))
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
