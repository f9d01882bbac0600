"""MAVLink signing against ArduCopter's own implementation, where CORDON_ARDUCOPTER names its simulator."""

import asyncio
import secrets
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agents.ports import FlightMode, Setpoint, VehicleRefusedError
from agents.shell.clock import WallClock
from estimation.frames import Geodetic, MissionFrame
from estimation.state import Telemetry
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.ports import free_ports
from gcs.link.signing_keys import set_up_signing
from gcs.mission.file import load_mission
from tests.support.arducopter import ArduCopterMissing, ArduCopterSimulator
from tests.support.wire import LOOPBACK, until

SPEED = 2.0
PLACE = (47.397742, 8.545594, 488.0)
FRAME = MissionFrame(Geodetic(*PLACE))
KEY, OTHER_KEY = secrets.token_bytes(32), secrets.token_bytes(32)
READY_WITHIN_S = 120.0
SET_MODE, LOITER, ALT_HOLD = 176, 5, 2


@pytest.fixture
def copter() -> Iterator[tuple[ArduCopterSimulator, str]]:
    port, usb_port = free_ports(2)
    try:
        simulator = ArduCopterSimulator(port, usb_port, speed=SPEED, place=PLACE)
    except ArduCopterMissing as missing:
        pytest.skip(str(missing))
    simulator.start()
    yield simulator, f"udpin://{LOOPBACK}:{port}"
    simulator.close()


def intrude(hub: MavsdkHub, url: str, mode: int, key: bytes | None) -> None:
    """Command a mode from the very address that the vehicle talks to, unsigned or signed with `key`."""
    relay, _ = hub._relays[url]
    claim = relay._gate.claims[1]
    assert claim.address is not None
    sender = mavlink.MAVLink(None, 245, 191)
    if key is not None:
        assert claim.signing is not None
        sender.signing.secret_key, sender.signing.sign_outgoing = key, True
        # A simulator that is faster than the wall has a clock ahead of it, and rejects new senders a minute behind.
        sender.signing.timestamp = claim.signing._latest
    command = mavlink.MAVLink_command_long_message(1, 1, SET_MODE, 0, 1, mode, 0, 0, 0, 0, 0)
    assert relay._carrier.send(command.pack(sender), claim.address)


def custom_mode_of(link: MavsdkLink) -> str:
    assert link._parts is not None
    return str(link._parts.feed.plugin.flight_mode().name)


async def linked(hub: MavsdkHub, url: str, key: bytes | None) -> MavsdkLink:
    config = LinkConfig(url, 1, FRAME, heartbeat_timeout_s=30.0, ready_timeout_s=180.0, signing_key=key)
    link, samples = MavsdkLink(hub, config, WallClock(SPEED)), list[Telemetry]()
    try:
        await link.connect(samples.append)
    except VehicleRefusedError:
        await link.close()
        raise
    return link


async def ready(hub: MavsdkHub, url: str) -> MavsdkLink:
    """Connect without a key, once its estimator has a position."""
    end_s = time.monotonic() + READY_WITHIN_S
    while True:
        try:
            return await linked(hub, url, None)
        except VehicleRefusedError:
            if time.monotonic() > end_s:
                raise


@pytest.mark.ardupilot
@pytest.mark.timeout(600)
async def test_arducopter_flies_signed_and_refuses_what_is_not(copter: tuple[ArduCopterSimulator, str]) -> None:
    _, url = copter
    hub = MavsdkHub()
    # Without a key it obeys any sender: the control of what follows.
    link = await ready(hub, url)
    for mode, name in ((ALT_HOLD, "ALTCTL"), (LOITER, "HOLD")):
        intrude(hub, url, mode, None)
        await until(lambda name=name: custom_mode_of(link) == name, 5.0, name)  # type: ignore[misc]
    await link.close()
    vehicle = load_mission("ardupilot-trio").vehicles[0]
    vehicle = replace(vehicle, section=vehicle.section.model_copy(update={"url": url}))
    (set_up,) = await set_up_signing([vehicle], {vehicle.system_id: KEY})
    assert set_up.signs, set_up
    with pytest.raises(VehicleRefusedError, match="another key"):
        await linked(hub, url, OTHER_KEY)
    link = await linked(hub, url, KEY)
    before = custom_mode_of(link)
    for key in (None, OTHER_KEY):
        intrude(hub, url, ALT_HOLD, key)
    await asyncio.sleep(2.0)
    assert custom_mode_of(link) == before
    intrude(hub, url, ALT_HOLD, KEY)  # the same command with the key
    await until(lambda: custom_mode_of(link) == "ALTCTL", waiting_for="the mode commanded with the key")
    await link.take_off(5.0)
    link.send(Setpoint((3.0, 0.0, 5.0)))
    await link.start_offboard()
    for key in (None, OTHER_KEY):
        intrude(hub, url, LOITER, key)
    for _ in range(40):
        link.send(Setpoint((3.0, 0.0, 5.0)))
        await asyncio.sleep(0.1)
    assert link.status.mode is FlightMode.OFFBOARD
    await link.land()
    assert not link.status.armed
    report = link.report
    assert report.signed
    assert report.impostors == {}
    print(f"dropped here: {report.dropped}")
    await link.close()
    await hub.close()
