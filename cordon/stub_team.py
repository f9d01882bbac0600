"""Stub vehicles for tests of MAVLink programs: a team of them in a process of its own, on ports of its own."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from math import inf
from numbers import Real
from pathlib import Path
from typing import Self

from agents.ports import VehicleRefusedError
from cordon.arguments import is_whole
from cordon.lockstep import LockstepClient
from cordon.simulation import load
from cordon.stub_vehicle import StubVehicle
from gcs.errors import InputError
from gcs.flight.stubs import clock_refusal, stub_configs
from gcs.link.ports import free_ports
from gcs.mission.mission import Mission
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import ESTIMATOR_READY_S
from sitl.server.governed_clock import GovernedClock
from sitl.server.process import StubProcess
from sitl.server.record import TruthTrack
from sitl.server.server import TRUTH_STEPS, StubConfig
from sitl.server.shared_clock import ClockError, ClockName, Rank, new_clock

_BETWEEN_SPEED = 1.0
"""The highest speed between waits: MAVLink clients have time limits by the wall's clock."""
_POLL_S = 0.05
_AIRBORNE_M = 0.5


class StubTeam:
    """Stub vehicles of a mission, by the ids of its vehicles, such as `team[1]`; `cordon.stubs` makes it.

    Use it with `with` or `async with`: at the beginning the vehicles stand at their starts, ready to arm; at the end
    their process ends, as it does with the program that started it. Simulated time passes as on the wall's clock, and
    faster while `until` or `wait_until` waits. It waits for the next setpoint where a vehicle flies in offboard by
    those of a client, for 3 s of the wall's clock at most.
    """

    def __init__(self, mission: Mission, configs: Sequence[StubConfig], speed: float) -> None:
        self.mission = mission
        self.ids = mission.ids[: len(configs)]
        self._configs = tuple(configs)
        self._speed = speed
        self._vehicles: dict[int, StubVehicle] = {}
        self._clock: ClockName | None = None
        self._process: StubProcess | None = None
        self._tracks: tuple[TruthTrack, ...] = ()
        self._stack = ExitStack()

    def __getitem__(self, vehicle_id: int) -> StubVehicle:
        """Return the vehicle of an id. Raises InputError."""
        if vehicle_id not in self._vehicles:
            known = ", ".join(map(str, self._vehicles)) or "none before it is used with `with` or `async with`"
            raise InputError([f"vehicle {vehicle_id!r}: there is none; the vehicles of the team: {known}"])
        return self._vehicles[vehicle_id]

    def __iter__(self) -> Iterator[StubVehicle]:
        """Iterate over the vehicles."""
        return iter(self._vehicles.values())

    def __len__(self) -> int:
        return len(self._configs)

    async def until(self, condition: Callable[[], bool], *, within_s: float = 60.0) -> float:
        """Wait in a coroutine until a condition holds; return the time since the vehicles booted [s].

        The time stands still while the condition computes, and goes on by 0.05 s at most while another task of this
        event loop does. Raises TimeoutError with the vehicles' states after `within_s` of simulated time, and
        VehicleRefusedError if the stubs have ended.
        """
        _require_positive("within_s", within_s)
        with GovernedClock(self._running_clock(), Rank.GUEST) as clock:
            clock.set_speed(self._speed)
            try:
                end_s = clock.now_s() + within_s
                while not condition():
                    self._require_left(end_s - clock.now_s(), within_s)
                    await clock.sleep(_POLL_S)
                return self._time_s()
            finally:
                clock.set_speed(min(self._speed, _BETWEEN_SPEED))

    def wait_until(self, condition: Callable[[], bool], *, within_s: float = 60.0) -> float:
        """Do as `until` does, in a program without an event loop."""
        _require_positive("within_s", within_s)
        self._running_clock()
        return self._wait(condition, within_s, self._speed)

    def inject(self, vehicle_id: int, fault: str) -> None:
        """Inject a fault into a vehicle from now on, by its name in `cordon fly --fault`, such as "link-cut".

        Raises InputError for an unknown one, and for one that is not a vehicle's but a flying process's.
        """
        from gcs.flight.faults.catalogue import vehicle_injections  # noqa: PLC0415 - it imports the bus
        from gcs.flight.faults.team_faults import TeamInFlight  # noqa: PLC0415

        vehicle = self[vehicle_id]
        places_m = {each.id: each.truth().position_m for each in self}
        flying = tuple(i for i, place_m in places_m.items() if i == vehicle_id or place_m[2] > _AIRBORNE_M)
        injections = vehicle_injections(TeamInFlight(self.mission, vehicle_id, flying, places_m))
        if fault not in injections:
            raise InputError([f"fault = {fault!r}: a vehicle has no such fault; give one of {', '.join(injections)}"])
        if self._process is not None:
            with suppress(OSError):  # it has ended: who asks for a state next is told
                self._process.inject(vehicle.system_id, injections[fault])

    def clear(self, vehicle_id: int | None = None) -> None:
        """Clear the faults of a vehicle, or of all; a battery stays as it is."""
        for vehicle in self if vehicle_id is None else (self[vehicle_id],):
            vehicle.clear()

    def save_tracks(self, path: str | Path) -> None:
        """Write the true tracks of a team that has ended as CSV, ten rows a second for each vehicle.

        Times are those since the vehicles booted [s], positions and velocities in the mission frame [m, m/s].
        """
        with Path(path).open("w", encoding="utf-8") as file:
            file.write("vehicle,time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s\n")
            for vehicle_id, track in zip(self.ids, self._tracks, strict=False):
                for row, motion in enumerate(zip(track.position_m, track.velocity_m_s, strict=True), start=1):
                    numbers = (row * TRUTH_STEPS * STEP_S, *motion[0], *motion[1])
                    file.write(",".join((str(vehicle_id), *(f"{number:.4f}" for number in numbers))) + "\n")

    def _wait(self, condition: Callable[[], bool], within_s: float, speed: float) -> float:
        with LockstepClient(*(vehicle.port for vehicle in self), speed=speed) as clock:
            end_s = clock.now_s + within_s
            while True:
                with clock.held_after(_POLL_S):
                    if condition():
                        return self._time_s()
                    self._require_left(end_s - clock.now_s, within_s)

    def _running_clock(self) -> ClockName:
        if self._clock is None:
            raise VehicleRefusedError("the stub vehicles do not run", "use the team with `with` or `async with`")
        return self._clock

    def _time_s(self) -> float:
        return next(iter(self)).truth().time_s

    def _require_left(self, left_s: float, within_s: float) -> None:
        if left_s <= 0.0:
            states = "; ".join(f"vehicle {each.id} {each.truth()}" for each in self)
            raise TimeoutError(f"the condition did not hold within {within_s:g} s: {states}")

    def __enter__(self) -> Self:
        """Start the vehicles. Raises VehicleRefusedError."""
        with ExitStack() as stack:
            process = self._started(stack)
            stack.callback(self._end)
            pairs = zip(self.ids, self._configs, strict=True)
            self._vehicles = {i: StubVehicle(i, config, process) for i, config in pairs}
            self._wait(lambda: self._time_s() > ESTIMATOR_READY_S, inf, inf)
            self._stack = stack.pop_all()
        return self

    def _started(self, stack: ExitStack) -> StubProcess:
        try:
            ports = [config.client_port for config in self._configs]
            self._clock = stack.enter_context(new_clock(min(self._speed, _BETWEEN_SPEED), ports))
            self._process = StubProcess(self._configs, partial(GovernedClock, self._clock, Rank.STUBS))
            self._process.start()
        except ClockError as error:
            raise clock_refusal(error) from error
        except OSError as error:
            raise VehicleRefusedError(f"the stub vehicles did not start: {error}", "see its output above") from error
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            with suppress(OSError):  # it has ended before: there are no tracks
                self._tracks = self._process.stop().tracks
        self._clock = None

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    async def __aenter__(self) -> Self:
        return self.__enter__()

    async def __aexit__(self, *_: object) -> None:
        self._stack.close()


def stubs(
    mission: Mission | str | Path, vehicles: int | None = None, *, speed: float = 10.0, seed: int | None = None
) -> StubTeam:
    """Return a team of stub vehicles of a mission, for `with` or `async with`, each on a free UDP port.

    - `mission`: a mission from `cordon.load`, or an argument of it.
    - `vehicles`: how many of the mission's vehicles, from its first on; None for all.
    - `speed`: how many times as fast as the wall's clock the time passes, at most, while `until` waits. Infinity: as
      fast as those come on that it waits for. A program that flies by the wall's clock needs 1.
    - `seed`: replaces the mission's.

    Raises InputError with every fault, and VehicleRefusedError if no port is free.
    """
    mission = mission if isinstance(mission, Mission) else load(mission)
    most = len(mission.ids)
    faults = []
    if not (vehicles is None or (is_whole(vehicles) and 1 <= vehicles <= most)):
        faults.append(f"vehicles: it must be from 1 to {most}, which the mission has (given: {vehicles!r})")
    if not (isinstance(speed, Real) and speed > 0.0):
        faults.append(f"speed: it must be a positive number (given: {speed!r})")
    if not (seed is None or (is_whole(seed) and seed >= 0)):
        faults.append(f"seed: it must be a whole number, not negative (given: {seed!r})")
    if faults:
        raise InputError(faults)
    ids = mission.ids[:vehicles]
    configs = stub_configs(mission, dict(zip(ids, free_ports(len(ids)), strict=True)))
    drawn = mission.mission.seed if seed is None else int(seed)
    return StubTeam(mission, [replace(each, seed=drawn, awaits_stream=True) for each in configs], float(speed))


def _require_positive(name: str, value: object) -> None:
    if not (isinstance(value, Real) and float(value) > 0.0):
        raise InputError([f"{name}: it must be a positive time (given: {value!r})"])
