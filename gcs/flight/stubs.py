"""The mission's vehicles as stubs: those that `cordon sitl` serves and `cordon fly --sitl` starts.

A flight of other vehicles imports nothing that serves stubs: it takes ten megabytes.
"""

import asyncio
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Self
from urllib.parse import urlsplit

from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock, WallClock
from estimation.frames import Triple
from gcs.autopilots.registry import autopilot_of
from gcs.errors import InputError
from gcs.link.relay.signing import wall_ticks
from gcs.link.signing_keys import signing_keys
from gcs.mission.mission import Mission, MissionVehicle
from gcs.signals import relay
from sitl.faults import VehicleInjection
from sitl.server.endpoint import StubClock
from sitl.server.governed_clock import GovernedClock
from sitl.server.one_core import OneCore
from sitl.server.record import StubRecord
from sitl.server.shared_clock import ClockError, ClockName, Rank, clock_of, new_clock

if TYPE_CHECKING:
    from sitl.server.process import StubProcess
    from sitl.server.server import StubConfig


def stub_configs(mission: Mission, ports: Mapping[int, int] | None = None) -> "list[StubConfig]":
    """Return one stub for each vehicle, on the ground at its start; it sends to the port of its url.

    With `ports`, by ids, these vehicles only, each to its port. Raises InputError for a url no stub can serve.
    """
    from sitl.mavlink.reports import EstimatorNoise  # noqa: PLC0415
    from sitl.server.server import StubConfig  # noqa: PLC0415

    ports = url_ports(mission, mission.ids) if ports is None else ports
    simulation = mission.simulation
    noise = EstimatorNoise(simulation.position_noise_m, simulation.velocity_noise_m_s)
    return [
        StubConfig(
            vehicle_id=vehicle.system_id,
            client_port=ports[vehicle.id],
            plant=vehicle.true_plant,
            frame=mission.mission_frame(),
            start_position_m=vehicle.section.start_m,
            origin_offset_m=_origin_offset_m(vehicle) if mission.frame.local else (0.0, 0.0, 0.0),
            gps=not mission.frame.local,
            noise=noise,
            wind_m_s2=simulation.wind_m_s2,
            seed=mission.mission.seed,
            autopilot=vehicle.autopilot,
            gimbal=vehicle.section.gimbal is not None,
        )
        for vehicle in mission.vehicles
        if vehicle.id in ports
    ]


def preparing_speed(vehicles: int) -> float:
    """Return the highest speed of stubs before take-off.

    Connecting to them takes wall time, in which the flight would go on. Until their rates are set, they stream more
    than one process takes from many at a higher speed.
    """
    return min(10.0, max(1.0, 30.0 / vehicles))


def url_ports(mission: Mission, ids: Collection[int]) -> dict[int, int]:
    """Return the ports of the urls of these vehicles, by their ids; raises InputError for a url no stub can serve."""
    stubs = [(index, vehicle) for index, vehicle in enumerate(mission.vehicles) if vehicle.id in ids]
    faults = [
        f"vehicles[{index}].url: stubs need a url like udpin://127.0.0.1:14540 (given: {vehicle.section.url!r})"
        for index, vehicle in stubs
        if urlsplit(vehicle.section.url).scheme != "udpin"
    ]
    if faults:
        raise InputError(faults)
    return {vehicle.id: urlsplit(vehicle.section.url).port or 0 for _, vehicle in stubs}


def prepared_configs(mission: Mission, ids: Collection[int], time_scale: float) -> "list[StubConfig]":
    """Return the stubs of these vehicles, with failsafes and signing keys set as docs/hardware.md requires.

    For flights that start their own vehicles, `time_scale` of whose seconds pass in one of the link. Raises InputError
    when the keys cannot be read.
    """
    from sitl.mavlink.signing import SigningKey  # noqa: PLC0415

    keys = {i: SigningKey(key, wall_ticks()) for i, key in signing_keys(mission).items()}
    return [
        replace(
            config,
            parameters=autopilot_of(config.autopilot).failsafe_parameters(time_scale),
            signing_key=keys.get(config.vehicle_id),
        )
        for config in stub_configs(mission, url_ports(mission, ids))
    ]


def _origin_offset_m(vehicle: MissionVehicle) -> Triple:
    """Return the origin of its local NED, relative to its start."""
    (x, y, z), (start_x, start_y) = vehicle.origin_m, vehicle.section.start_m
    return x - start_x, y - start_y, z


async def serve_until_ctrl_c(configs: "Sequence[StubConfig]", make_clock: Callable[[], StubClock]) -> None:
    """Serve stubs until SIGINT or SIGTERM; raises OSError when a socket cannot be opened, ClockError."""
    from sitl.server.server import serve  # noqa: PLC0415

    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    relay(lambda: loop.call_soon_threadsafe(stop.set))
    clock = make_clock()
    try:
        with OneCore() if isinstance(clock, GovernedClock) else nullcontext():
            await serve(configs, clock, stop)
    finally:
        clock.close()


def lockstep_clock(mission: Mission, ids: Collection[int]) -> ClockName | None:
    """Return the clock of stubs of this computer that wait for their clients, None if one of `ids` is no such stub."""
    urls = [urlsplit(mission.vehicle(each).section.url) for each in ids]
    if any(url.scheme != "udpin" for url in urls):
        return None
    return clock_of({url.port or 0 for url in urls})


def clock_refusal(error: ClockError) -> VehicleRefusedError:
    """Return the refusal of a flight whose clock cannot be made."""
    return VehicleRefusedError(
        f"the clock of the stub vehicles: {error}", "free memory there, or name another folder by CORDON_CLOCKS"
    )


@contextmanager
def served_clock(speed: float, ports: Collection[int], *, lockstep: bool) -> Iterator[Callable[[], StubClock]]:
    """Return what makes the clock of stubs that send to `ports`: the wall's, or in `lockstep` one that flights join.

    Raises VehicleRefusedError.
    """
    if not lockstep:
        yield partial(WallClock, speed)
        return
    try:
        with new_clock(speed, ports) as name:
            yield partial(GovernedClock, name, Rank.STUBS)
    except ClockError as error:
        raise clock_refusal(error) from error


def _clock_maker(clock: MissionClock) -> Callable[[], StubClock]:
    """Return what makes the same clock in the process of the stubs."""
    if isinstance(clock, GovernedClock):
        return partial(GovernedClock, clock.name, Rank.STUBS)
    return partial(WallClock, clock.speed)


def _stub_process(mission: Mission, ids: Collection[int], clock: MissionClock) -> "StubProcess":
    from sitl.server.process import StubProcess  # noqa: PLC0415

    return StubProcess(prepared_configs(mission, ids, clock.time_scale), _clock_maker(clock))


class FlightStubs:
    """The stub vehicles that a flight starts itself; their record is available once they have been stopped."""

    def __init__(self, mission: Mission, ids: Collection[int], clock: MissionClock) -> None:
        """Prepare the stubs of these vehicles, or none."""
        self._process = _stub_process(mission, ids, clock) if ids else None
        self.record: StubRecord | None = None

    async def __aenter__(self) -> Self:
        """Start them; raises VehicleRefusedError."""
        try:
            if self._process is not None:
                await asyncio.to_thread(self._process.start)
        except OSError as error:
            raise VehicleRefusedError(
                f"the stub vehicles did not start: {error}", "check whether other stub vehicles run already"
            ) from error
        return self

    def inject(self, system_id: int, injection: VehicleInjection) -> None:
        """Inject a fault into a vehicle."""
        if self._process is not None:
            with suppress(OSError):  # they died in flight
                self._process.inject(system_id, injection)

    async def __aexit__(self, *_: object) -> None:
        if self._process is not None:
            with suppress(OSError):  # they died in flight: outcomes report it, the record uses estimates
                self.record = await asyncio.to_thread(self._process.stop)
