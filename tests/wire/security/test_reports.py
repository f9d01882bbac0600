"""The reports of vehicles on the bus: who looks on receives them, vehicles do not, and none in another's name."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import zenoh

from agents.shell.zenoh_bus import ParticipantBus, single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import REPORT_TOPIC, BusMessage, MemberState, VehicleReport
from agents.team.participant import Participant, Role
from gcs.keys.authority_folder import AuthorityFolder
from gcs.keys.identity import Identity
from gcs.keys.key_folder import KeyFolder
from tests.support.wire import free_port, until

pytestmark = pytest.mark.wire

TEAM = BusTeam("reports", (1, 2, 3))
LOOKING_ON: tuple[tuple[Role, str], ...] = (("observer", "tower"), ("operator", "anna"))
OTHERS: tuple[tuple[Role, str], ...] = (("vehicle", "2"), ("sensor", "mast"))
STATE = encode(MemberState(1, 1.0, "land", (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))
FORGED = "forged"


def without_keys(_folder: Path) -> Callable[[Role, str], Identity]:
    return lambda role, name: Identity(Participant(role, name))


def with_keys(folder: Path) -> Callable[[Role, str], Identity]:
    authority = AuthorityFolder(folder)
    authority.init(10.0)
    for role, name in (("vehicle", "1"), ("vehicle", "3"), *LOOKING_ON, *OTHERS):
        authority.issue(role, name, 1.0)  # type: ignore[arg-type]
    return KeyFolder(folder).identity


@asynccontextmanager
async def joined(
    identity: Identity, endpoint: str, heard: list[BusMessage], *, listens: bool = False
) -> AsyncIterator[ParticipantBus]:
    """Join the team's bus, where vehicle 1 listens."""
    listen, connect = (endpoint, []) if listens else (None, [endpoint])
    bus = single_bus(identity.participant, TEAM, listen, connect, identity.security)
    try:
        await bus.open(heard.append, lambda *_: None, lambda *_: None)
        yield bus
    finally:
        await bus.close()


@asynccontextmanager
async def forger(identity: Identity, endpoint: str) -> AsyncIterator[zenoh.Session]:
    """Join with the keys of vehicle 3, without a program of cordon's."""
    config, security = zenoh.Config(), identity.security
    tls = {} if security is None else {"transport/link/tls": security.settings(TEAM.name)["transport/link/tls"]}
    scheme = "tcp" if security is None else "tls"
    ends = {"listen/endpoints": [], "connect/endpoints": [f"{scheme}/{endpoint.partition('/')[2]}"]}
    for path, value in ({"mode": "peer", "scouting/multicast/enabled": False} | ends | tls).items():
        config.insert_json5(path, json.dumps(value))
    session = await asyncio.to_thread(zenoh.open, config)
    try:
        yield session
    finally:
        await asyncio.to_thread(session.close)


@pytest.mark.parametrize("keys", [without_keys, with_keys])
async def test_who_looks_on_receives_reports_and_vehicles_do_not(
    keys: Callable[[Path], Callable[[Role, str], Identity]], tmp_path: Path
) -> None:
    identity, endpoint = keys(tmp_path / "keys"), f"tcp/127.0.0.1:{free_port()}"
    heard: dict[str, list[BusMessage]] = {name: [] for _, name in (("vehicle", "1"), *LOOKING_ON, *OTHERS)}
    async with joined(identity("vehicle", "1"), endpoint, heard["1"], listens=True) as one:
        others = [joined(identity(role, name), endpoint, heard[name]) for role, name in (*LOOKING_ON, *OTHERS)]
        async with others[0], others[1], others[2], others[3]:

            def said() -> bool:
                one.publish(REPORT_TOPIC, encode(VehicleReport(1, 1.0, "offboard")))
                one.publish("member", STATE)
                kinds = {name: {type(each) for each in heard[name]} for name in heard}
                looking_on = all(kinds[name] == {MemberState, VehicleReport} for _, name in LOOKING_ON)
                return looking_on and all(MemberState in kinds[name] for _, name in OTHERS)

            await until(said)
            await asyncio.sleep(0.2)
    assert {type(each) for _, name in OTHERS for each in heard[name]} == {MemberState}


@pytest.mark.parametrize(("keys", "is_heard"), [(without_keys, True), (with_keys, False)])
async def test_with_keys_no_vehicle_reports_in_the_name_of_another(
    keys: Callable[[Path], Callable[[Role, str], Identity]], is_heard: bool, tmp_path: Path
) -> None:
    """The keys of vehicle 3 put on the key of vehicle 1, by a program without rules, straight to an observer."""
    identity, endpoint = keys(tmp_path / "keys"), f"tcp/127.0.0.1:{free_port()}"
    heard: list[BusMessage] = []
    async with (
        joined(identity("observer", "tower"), endpoint, heard, listens=True),
        forger(identity("vehicle", "3"), endpoint) as session,
    ):

        def said() -> bool:
            for sender in (1, 3):
                report = encode(VehicleReport(sender, 1.0, FORGED))
                session.put(f"{TEAM.prefix}/{REPORT_TOPIC}/{sender}", report)
            return any(each.sender == 3 for each in heard if isinstance(each, VehicleReport))

        await until(said)
        for _ in range(5):
            said()
            await asyncio.sleep(0.05)
    assert {each.sender for each in heard if isinstance(each, VehicleReport)} == ({1, 3} if is_heard else {3})
