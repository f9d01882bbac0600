"""Who may speak for a vehicle on its MAVLink link: strangers before and during a flight, and signing both ways."""

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from agents.flight_end import FlightEnd
from agents.ports import FlightMode, Setpoint, VehicleRefusedError
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Telemetry
from gcs.console.live import LiveView
from gcs.console.vehicle_view import TeamRow
from gcs.flight.flight import fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.relay.frames import is_autopilot_heartbeat
from gcs.link.relay.signing import SignatureCheck, Signing, wall_ticks
from gcs.link.signing_keys import issue_keys, set_up_signing
from gcs.mission.file import load_mission, mission_path, parse_mission
from gcs.preflight.findings import Finding, Grade
from sitl.mavlink.protocol import Drop
from sitl.mavlink.signing import SigningKey
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import Stub, StubConfig
from tests.support.forger import Forger
from tests.support.mission_text import LOW
from tests.support.wire import LOOPBACK, free_port, repeated, served_by, stub_clock, until

pytestmark = pytest.mark.wire

SPEED = 10.0
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0))
PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(0.8, 0.87))
KEY, OTHER_KEY = secrets.token_bytes(32), secrets.token_bytes(32)


@asynccontextmanager
async def served(clock: GovernedClock, *configs: StubConfig) -> AsyncIterator[Sequence[Stub]]:
    async with served_by(clock, configs) as stubs:
        yield tuple(stubs.values())


@asynccontextmanager
async def linked(
    clock: GovernedClock, config: StubConfig, *, key: bytes | None = None, timeout_s: float = 10.0
) -> AsyncIterator[MavsdkLink]:
    hub = MavsdkHub(clock)
    url = f"udpin://{LOOPBACK}:{config.client_port}"
    link_config = LinkConfig(url, config.vehicle_id, FRAME, heartbeat_timeout_s=timeout_s, signing_key=key)
    link = MavsdkLink(hub, link_config, clock)
    try:
        yield link
    finally:
        await link.close()
        await hub.close()


@pytest.fixture
async def clock() -> AsyncIterator[GovernedClock]:
    with stub_clock(SPEED) as clock:
        yield clock


def forget(_telemetry: Telemetry) -> None:
    pass


async def test_forged_messages_have_no_effect_on_a_flight(
    clock: GovernedClock, mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = load_mission(mission_file("case2", LOW))
    rows, told = dict[int, TeamRow](), list[Finding]()
    view = LiveView(Console(file=StringIO()))
    monkeypatch.setattr(view, "update", lambda team, *_: rows.update({row.vehicle_id: row for row in team}))
    places: list[float] = []
    verified = set[int]()
    take = MavsdkLink.connect

    async def connected(link: MavsdkLink, on_telemetry: Callable[[Telemetry], None]) -> None:
        def note(telemetry: Telemetry) -> None:
            places.append(max(map(abs, telemetry.position_m)))
            verified.add(link._config.system_id)
            on_telemetry(telemetry)

        await take(link, note)

    monkeypatch.setattr(MavsdkLink, "connect", connected)
    forgers = {config.vehicle_id: Forger(config.vehicle_id) for config in stub_configs(mission)}
    ports = {config.vehicle_id: config.client_port for config in stub_configs(mission)}
    modes = set[str]()

    async def forge() -> None:
        while True:
            for system_id, forger in forgers.items():
                forger.heartbeat(ports[system_id])
                forger.position(ports[system_id], 900.0)
            modes.update(row.mode for row in rows.values())
            await asyncio.sleep(0.02)

    async with served(clock, *stub_configs(mission)) as stubs:
        plan = FlightPlan(mission, 8.0, mission.vehicles, speed=SPEED, clock=clock.name)
        flight = asyncio.create_task(fly(plan, view, told.extend))
        # The vehicles are verified once their telemetry comes; preflight and take-off are still ahead.
        await until(lambda: flight.done() or verified == set(ports), waiting_for="telemetry")
        forging = asyncio.create_task(forge())
        outcomes = (await flight).outcomes
        forging.cancel()
    assert [outcome.how for outcome in outcomes.values()] == [FlightEnd.LANDED] * 3, outcomes
    assert max(places) < 100.0
    assert modes <= {mode.value for mode in FlightMode} - {FlightMode.OTHER.value}
    assert all(stub.setpoints for stub in stubs)
    # Nothing was ever sent to the forgers; the operator was told of each, once, and by its address.
    assert [forger.received() for forger in forgers.values()] == [0, 0, 0]
    warned = [each for each in told if each.check == "impostor"]
    for system_id, forger in forgers.items():
        named = [each for each in warned if each.subject == f"vehicle {system_id}" and forger.address in each.found]
        assert 1 <= len(named) <= 2, told  # at the preflight check and in flight
        assert {each.grade for each in named} == {Grade.WARNING}
        forger.close()


async def test_two_senders_with_one_system_id_are_refused_with_their_addresses(clock: GovernedClock) -> None:
    config, forger = StubConfig(1, free_port(), PLANT, FRAME), Forger(1)

    async def forge() -> None:
        while True:
            forger.heartbeat(config.client_port)
            await asyncio.sleep(0.05)

    forging = asyncio.create_task(forge())
    async with served(clock, config) as (stub,), linked(clock, config) as link:
        with pytest.raises(VehicleRefusedError) as refusal:
            await link.connect(forget)
        vehicle = stub.endpoint._transport.get_extra_info("sockname")  # type: ignore[union-attr]
    forging.cancel()
    assert forger.address in refusal.value.reason
    assert f"{vehicle[0]}:{vehicle[1]}" in refusal.value.reason
    assert forger.received() == 0
    forger.close()


async def test_a_vehicle_is_followed_to_another_port_after_a_silence_only(clock: GovernedClock) -> None:
    config, samples = StubConfig(1, free_port(), PLANT, FRAME), list[Telemetry]()
    stranger = Forger(1, host="127.0.0.2")
    async with linked(clock, config) as link:
        async with served(clock, config):
            await link.connect(samples.append)
            await until(lambda: len(samples) > 5, 30.0, "telemetry", clock=clock)
        silent_s = clock.now_s()
        async with served(clock, config):  # it has another port now
            samples.clear()
            while not link.report.moves:
                stranger.heartbeat(config.client_port)  # from another host, which is not followed
                assert clock.now_s() < silent_s + 8.0
                await clock.sleep(0.05)
            assert clock.now_s() - silent_s > 2.5
            await until(lambda: bool(samples), waiting_for="telemetry from there")
            assert len(link.report.moves) == 1
            assert link.report.address == link.report.moves[0]
            assert stranger.address in link.report.impostors
            assert stranger.received() == 0
    stranger.close()


async def test_a_signed_vehicle_flies_and_obeys_its_key_only(clock: GovernedClock) -> None:
    port = free_port()
    config = StubConfig(1, free_port(), PLANT, FRAME, port=port, signing_key=SigningKey(KEY, wall_ticks()))
    strangers = Forger(245), Forger(245, OTHER_KEY)
    replayed: list[bytes] = []
    async with served(clock, config) as (stub,), linked(clock, config, key=KEY) as link:
        vehicle = stub._vehicle
        receive = vehicle.receive

        def noted(data: bytes, time_s: float) -> list[bytes]:
            replayed.append(data)
            return receive(data, time_s)

        vehicle.receive = noted  # type: ignore[method-assign]
        await link.connect(forget)
        await link.take_off(3.0)
        dropped = vehicle.dropped[Drop.SIGNATURE]
        for stranger in strangers:
            stranger.disarm(1, port)
        await until(lambda: vehicle.dropped[Drop.SIGNATURE] >= dropped + 2, 30.0, "refusals", clock=clock)
        assert stub.autopilot.armed
        early = replayed[:15]
        for data in early:
            receive(data, 0.0)
        assert vehicle.dropped[Drop.SIGNATURE] >= dropped + 2 + len(early), "replayed commands were accepted"
        assert stub.autopilot.armed
        link.send(Setpoint((2.0, 0.0, 3.0)))
        await link.start_offboard()
        await link.land()
        assert link.status.armed is stub.autopilot.armed is False
        assert link.report.signed
        assert sum(link.report.dropped.values()) == 0
    for stranger in strangers:
        stranger.close()


@pytest.mark.parametrize(
    ("has", "verdict"), [(None, "not signed"), (OTHER_KEY, "another key")], ids=["unsigned", "another key"]
)
async def test_a_vehicle_that_does_not_sign_with_its_key_is_refused(
    clock: GovernedClock, has: bytes | None, verdict: str
) -> None:
    signing_key = None if has is None else SigningKey(has, wall_ticks())
    config = StubConfig(1, free_port(), PLANT, FRAME, signing_key=signing_key)

    async def attempt() -> None:
        async with linked(clock, config, key=KEY, timeout_s=1.0) as link:
            with pytest.raises(VehicleRefusedError) as refusal:
                await link.connect(forget)
        assert verdict in refusal.value.reason
        assert "signing_key_file" in refusal.value.reason + refusal.value.next_step

    async with served(clock, config):
        await repeated(attempt)


async def test_forged_telemetry_on_a_signed_link_has_no_effect_even_first_and_alone(clock: GovernedClock) -> None:
    # A clock that is an hour behind, as of a vehicle that was switched off: a signed heartbeat sets it.
    behind = wall_ticks() - 3600 * 100_000
    config = StubConfig(1, free_port(), PLANT, FRAME, port=free_port(), signing_key=SigningKey(KEY, behind))
    forgers = Forger(1), Forger(1, OTHER_KEY)

    async def forge() -> None:
        while True:
            for forger in forgers:
                forger.heartbeat(config.client_port)
            await asyncio.sleep(0.02)

    forging = asyncio.create_task(forge())
    async with linked(clock, config, key=KEY) as link:
        connecting = asyncio.create_task(link.connect(forget))
        await asyncio.sleep(0.3)
        async with served(clock, config):
            await connecting
            assert link.report.address == f"{LOOPBACK}:{config.port}"
            assert link.status.mode is not FlightMode.OTHER
    forging.cancel()
    assert [forger.received() for forger in forgers] == [0, 0]
    for forger in forgers:
        forger.close()


async def test_what_a_signed_vehicle_sent_is_refused_in_the_next_run(
    clock: GovernedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = StubConfig(1, free_port(), PLANT, FRAME, signing_key=SigningKey(KEY, wall_ticks()))
    verify, sent = Signing.verify, list[bytes]()

    def noted(signing: Signing, frame: bytes) -> SignatureCheck:
        sent.append(frame)
        return verify(signing, frame)

    monkeypatch.setattr(Signing, "verify", noted)
    async with served(clock, config), linked(clock, config, key=KEY) as link:
        await link.connect(forget)
    recorded, forger = tuple(sent), Forger(1)
    heartbeats = [frame for frame in recorded if is_autopilot_heartbeat(frame)]
    assert heartbeats

    async def replay() -> None:
        while True:
            for frame in heartbeats:
                forger.replay(frame, config.client_port)
                await asyncio.sleep(0.02)

    replaying = asyncio.create_task(replay())
    async with linked(clock, config, key=KEY, timeout_s=3.0) as link:
        with pytest.raises(VehicleRefusedError, match="signed at an earlier time"):
            await link.connect(forget)
    replaying.cancel()
    forger.close()


async def test_a_key_is_set_up_on_a_vehicle_without_one_and_on_no_other(clock: GovernedClock, tmp_path: Path) -> None:
    mission = parse_mission(mission_path("px4-trio").read_text(), tmp_path)
    configs = [replace(config, client_port=free_port()) for config in stub_configs(mission)[:2]]
    vehicles = [
        replace(each, section=each.section.model_copy(update={"url": f"udpin://{LOOPBACK}:{config.client_port}"}))
        for each, config in zip(mission.vehicles, configs, strict=False)
    ]
    configs[1] = replace(configs[1], signing_key=SigningKey(OTHER_KEY, wall_ticks()))
    keys = issue_keys(tmp_path / "mavlink.keys", [1, 2])
    async with served(clock, *configs) as (bare, other):
        first = await set_up_signing(vehicles, keys)
        assert [each.signs for each in first] == [True, False]
        assert all(each.next_step for each in first if not each.signs)
        assert bare._vehicle._signing._state.secret_key == keys[1]
        assert other._vehicle._signing._state.secret_key == OTHER_KEY
        assert [each.signs for each in await set_up_signing(vehicles[:1], keys)] == [True]
