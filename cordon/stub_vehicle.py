"""One stub vehicle of a team for tests of MAVLink programs."""

from collections.abc import Callable
from math import isfinite
from numbers import Real

from agents.ports import VehicleRefusedError
from estimation.frames import Triple
from gcs.errors import InputError
from sitl.server.process import StubProcess, StubRequest
from sitl.server.server import Stub, StubConfig
from sitl.server.true_state import TrueState


class StubVehicle:
    """One stub vehicle of a team: where MAVLink clients connect to it, its true state, and its commands.

    `id` is the vehicle's in the mission, `system_id` that of MAVLink. `url` is what MAVSDK, QGroundControl and `cordon`
    connect to, `pymavlink_url` what `mavutil.mavlink_connection` takes; both listen to the UDP `port`, to which the
    vehicle sends. Its commands need no connection, and disturb none.
    """

    def __init__(self, vehicle_id: int, config: StubConfig, process: StubProcess) -> None:
        self.id = vehicle_id
        self.system_id = config.vehicle_id
        self.port = config.client_port
        self.url = f"udpin://{config.client_host}:{self.port}"
        self.pymavlink_url = f"udpin:{config.client_host}:{self.port}"
        self._process = process

    def truth(self) -> TrueState:
        """Return the true state now. Raises VehicleRefusedError if the stub has ended."""
        return self._ask()

    def arm(self) -> None:
        """Arm in the present mode. Raises VehicleRefusedError."""
        self._ask(Stub.arm)

    def goto(self, x_m: float, y_m: float, z_m: float) -> None:
        """Fly to a position in the mission frame [m], z up, in offboard; from the ground it takes off.

        It stays there until a client sends setpoints or selects a mode. Raises VehicleRefusedError, as when it is not
        armed, and InputError.
        """
        given: dict[str, object] = {"x_m": x_m, "y_m": y_m, "z_m": z_m}
        faults = [
            f"{name}: it must be a finite number of metres (given: {value!r})"
            for name, value in given.items()
            if not (isinstance(value, Real) and isfinite(value))
        ]
        if faults:
            raise InputError(faults)
        self._ask(Stub.go_to, (float(x_m), float(y_m), float(z_m)))

    def clear(self) -> None:
        """Clear its faults; its battery stays as it is. Raises VehicleRefusedError if the stub has ended."""
        self._ask(Stub.clear)

    def _ask(self, call: Callable[..., str] | None = None, *arguments: Triple) -> TrueState:
        name = f"vehicle {self.id}:"
        try:
            state, refusal = self._process.ask(StubRequest(self.system_id, call, arguments))
        except OSError as error:
            raise VehicleRefusedError("its stub has ended", "start another team", subject=name) from error
        if refusal:
            next_step = "look at its mode, and whether it is armed, in truth()"
            raise VehicleRefusedError(refusal, next_step, subject=name)
        return state
