"""The readers of external inputs that are fuzzed: messages, files and pages' requests, each with valid inputs."""

import asyncio
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from math import isfinite
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from pymavlink.dialects.v20 import ardupilotmega, common
from starlette.types import Message

from agents.safety.fence import Fence
from agents.team.codec import decode, encode
from agents.team.external_positions import ExternalPose, ExternalPoses, ExternalPositions
from agents.team.messages import (
    CommandAnswer,
    MemberState,
    MissionIdentity,
    NeighbourAngle,
    OperatorCommand,
    StartProposal,
    TargetPackage,
    TargetReport,
    VehicleReport,
)
from agents.team.perception import ExternalSighting, Perception, encode_sighting
from agents.team.verbs import VERBS
from estimation.input_file import toml_content
from estimation.profile.profile import ProfileError, ProfileLibrary
from gcs.errors import InputError
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import read_log
from gcs.flightlog.recover import examine
from gcs.flightlog.run import mission_of
from gcs.keys.certificates import CertificateAuthority
from gcs.keys.roster import (
    ROSTER_FILE,
    SERIAL_FILE,
    Holder,
    KeptRoster,
    Roster,
    digest,
    is_signed_roster,
    read_roster,
    roster_view,
    unverified_roster,
)
from gcs.link.relay.frames import FrameStream, is_signed, target_system
from gcs.link.relay.gate import Claim, FrameGate
from gcs.link.relay.signing import EPOCH_UNIX_S, KEY_LENGTH, TICKS_PER_S, Signing
from gcs.mission.file import MissionError, load_mission
from gcs.mission.sections import SECTIONS
from gcs.report.flight_book import read_book
from gcs.station.access import Access, AccessGate, Hello
from gcs.station.broadcast import Broadcast
from gcs.station.commands import Commands
from gcs.station.server import REQUEST_MAX_BYTES, Stream, live_app
from gcs.vehicle_logs import dataflash, own_log, tlog, ulog
from gcs.vehicle_logs.log_file import STAMP_BYTES, open_log, quiet
from gcs.viewer.connections import ConnectionLimits
from gcs.viewer.origin_gate import Address
from gcs.zones.layout import laid_out
from gcs.zones.reading import read_drawing
from gcs.zones.tables import tables_text
from tests.support.cut_logs import BIN_KEPT, ULOG_EVERY, cut_bin, cut_ulog
from tests.support.drawn_field import geojson, kml, plan
from tests.support.flight_logs import engaging, record_simulation
from tests.support.fuzzing import Target
from tests.support.paths import DATA, MISSIONS, PROFILES
from tests.support.telemetry_log import BEGIN_US, Station

NOW_S = 1e9


def target_named(name: str, folder: Path) -> Target:
    """Return a target; its reader writes files into `folder`."""
    return TARGETS[name](folder)


def _written(path: Path, read: Callable[[Path], object]) -> Callable[[bytes], object]:
    def read_file(data: bytes) -> object:
        path.write_bytes(data)
        return read(path)

    return read_file


# What arrives on the bus.


def _bus(_: Path) -> Target:
    two = (1.0, -2.0)
    angle = NeighbourAngle(2, NOW_S, 1.0, 0.05, 10.0)
    package = TargetPackage(2, NOW_S, two, (1.0, 0.0, 1.0), 0.8, 0.2, (1, 2))
    messages = (
        MemberState(1, NOW_S, "formation", two, two, two, two, 8.0, 0.1, "battery low", "wedge", NOW_S),
        MemberState(2, NOW_S, "encircle", two, two, two, two, angle=angle, sightings=(package,)),
        StartProposal(1, NOW_S, NOW_S + 2.0, mission=MissionIdentity("case2", "0123456789abcdef")),
        OperatorCommand(NOW_S, "formation", None, "somebody@somewhere", 7, "line"),
        CommandAnswer(2, NOW_S, 7, "holds"),
        VehicleReport(1, NOW_S, "offboard", ended="landed", target=TargetReport(two, two, (1.0, 0.0, 1.0), 0.5)),
    )

    def read(data: bytes) -> object:
        message = decode(data)
        assert decode(encode(message)) == message
        return message

    return Target("bus", [encode(message) for message in messages], read, (ValueError,), 3000)


def _sensor(_: Path) -> Target:
    """What sensors send is refused without an error."""
    covariance = (1.0, 0.1, 1.0)
    sightings = (
        ExternalSighting("mission", (35.0, -5.0), covariance, 0.8, 0.2, time_s=NOW_S, source=3),
        ExternalSighting("geodetic", (47.3977, 8.5456), covariance, 0.8, 0.2, altitude_m=3.0),
    )
    poses = ExternalPoses((ExternalPose(1, (1.0, 2.0, 3.0), 0.5), ExternalPose(2, (1.0, 2.0, 3.0))), NOW_S)
    perception = Perception(engaging("case2").mission_frame(), lambda _: None)
    positions = ExternalPositions(1, lambda _: None)

    def read(data: bytes) -> object:
        return perception.take(data, NOW_S, 1.0), positions.take(data, NOW_S)

    return Target("sensor", [*map(encode_sighting, sightings), msgspec.json.encode(poses)], read, (), 1000)


# Files of users.


def _mission(folder: Path) -> Target:
    def load(path: Path) -> object:
        """Read a sound mission, or faults of which each is a line."""
        try:
            mission = load_mission(str(path))
        except MissionError as error:
            if not error.faults or any(len(fault.splitlines()) != 1 for fault in error.faults):
                raise AssertionError(error.faults) from error
            raise
        assert len(set(mission.ids)) == len({each.system_id for each in mission.vehicles}) == len(mission.vehicles) > 0
        assert mission.formation.leader in mission.ids
        for name in SECTIONS.keys() - {"decision"}:
            assert all(map(isfinite, _numbers(getattr(mission, name).model_dump())))
        for vehicle in mission.vehicles:
            assert all(map(isfinite, _numbers(vehicle.section.model_dump(exclude_unset=True))))
            assert all(map(isfinite, _numbers(vehicle.own_filter.model_dump())))
            assert mission.agent_config(vehicle).vehicle_id == vehicle.id
        return mission

    read = _written(folder / "mission.toml", load)
    return Target("mission", [path.read_bytes() for path in sorted(MISSIONS.glob("*.toml"))], read, (InputError,), 300)


def _zones(folder: Path) -> Target:
    """Read areas of which each is a mission's zone: finite, with corners enough, and not crossing itself."""
    frame = engaging("case2").mission_frame()

    def load(path: Path) -> object:
        layout = laid_out(read_drawing(path), frame)
        for area in layout.zones:
            assert all(map(isfinite, chain(*area.corners_m)))
            assert area.radius_m > 0.0 or (len(area.corners_m) >= 3 and Fence(area.corners_m).crossed_edges() is None)
        assert toml_content(tables_text(layout)) is not None
        return layout

    valid = [text.encode() for text in (plan(), geojson(), kml())]
    return Target("zones", valid, _written(folder / "field", load), (InputError,), 600)


def _numbers(value: object) -> Iterator[float]:
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
        yield from _numbers(part)
    if isinstance(value, float):
        yield value


def _profile(_: Path) -> Target:
    def read(data: bytes) -> object:
        return ProfileLibrary(None, {"own": data.decode(errors="replace")}).load("own")

    valid = [path.read_bytes() for path in sorted(PROFILES.glob("*.toml"))]
    return Target("profile", valid, read, (ProfileError,), 700)


_AUTHORITY = "the authority's digest"
"""It stands for the digest in inputs, since each run has an authority of its own."""


def _roster(folder: Path) -> Target:
    authority, path = CertificateAuthority.made(days=1.0), folder / ROSTER_FILE
    pem = authority.keys.certificate_pem
    holders = (
        *(Holder("vehicle", str(number), 4e9, speaks_for=(3, 4)) for number in (1, 2)),
        Holder("operator", "anna", 4e9, tuple(VERBS), generation=3),
        Holder("operator", "bert", 4e9, ("hold",), revoked=True),
        *(Holder(role, f"{role}.{role}", 4e9) for role in ("sensor", "positions", "observer", "router")),
    )

    def read(data: bytes) -> object:
        path.with_name(SERIAL_FILE).unlink(missing_ok=True)
        path.write_bytes(data.replace(_AUTHORITY.encode(), digest(pem).encode()))
        roster = unverified_roster(path, pem)
        roster_view(roster)
        assert not is_signed_roster(roster, pem)
        signed = roster.put(*roster.holders).signed(authority.sign)
        path.write_bytes(signed.encoded())
        assert read_roster(path, pem) == signed
        assert KeptRoster(path, pem).take(signed.compact()) is not None
        return [each.grant for each in roster.holders]

    valid = [
        Roster(_AUTHORITY, 7, holders[:3], b"signature").compact(),
        Roster(_AUTHORITY, 7, holders[3:]).encoded(),
    ]
    return Target("roster", valid, read, (InputError,), 500)


# Logs.


def _container(folder: Path) -> Target:
    def read(path: Path) -> object:
        examine(path, lambda _share: None)
        log = read_log(path)
        for records in (log.run_records, *log.vehicles.values()):
            for record in records:
                record.read(record.kind)
        _ = log.carried, log.end, log.recovered
        mission_of(log)
        read_book([path], lambda _share: None).to_dict()
        with quiet():
            return own_log.read(open_log(path))

    return Target("container", [_unpacked_log(folder)], _written(folder / "fuzzed.mcap", read), (LogError,), 100)


def _unpacked_log(folder: Path) -> bytes:
    """Return a short log, neither compressed nor with checksums: else a changed byte would only cost its chunk."""
    source, target = folder / "recorded.mcap", folder / "unpacked.mcap"
    source.unlink(missing_ok=True)
    record_simulation(engaging(), source, duration_s=0.3)
    seen: Counter[str] = Counter()
    channels: dict[int, int] = {}
    with source.open("rb") as log, target.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000, compression=CompressionType.NONE, enable_crcs=False)
        writer.start("cordon")
        for schema, channel, message in make_reader(log).iter_messages():
            seen[channel.topic] += 1
            if schema is None or channel.topic[:10] in ("/vehicle/1", "/vehicle/3") or seen[channel.topic] > 2:
                continue
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return target.read_bytes()


def _vehicle_log(reader: ModuleType, path: Path) -> Callable[[bytes], object]:
    def read(path: Path) -> object:
        try:
            with quiet():
                logs = reader.read(open_log(path))
        except LogError as error:
            if not all(path.name in fault for fault in error.faults):
                raise AssertionError(error.faults) from error
            raise
        for log in logs:
            assert log.duration_s >= 0.0
            for name, series in log.series().items():
                assert (np.diff(series.time_s) > 0.0).all()
                assert np.isfinite(series.values).all() or name in ("setpoint", "battery")
                assert series.time_s[0] >= 0.0
        return logs

    return _written(path, read)


def _ulog(folder: Path) -> Target:
    every = {name: 8 * each for name, each in ULOG_EVERY.items()}
    log = cut_ulog((DATA / "px4-quad.ulg").read_bytes(), (20_500_000, 24_000_000), every)
    return Target("ulog", [log], _vehicle_log(ulog, folder / "fuzzed.ulg"), (LogError,), 200)


def _dataflash(folder: Path) -> Target:
    every: Mapping[str, int] = {"XKF1": 15, "SIM": 30, "GUIP": 40}
    log = cut_bin((DATA / "arducopter.bin").read_bytes(), 70_000_000, BIN_KEPT, every=every)
    return Target("dataflash", [log], _vehicle_log(dataflash, folder / "fuzzed.bin"), (LogError,), 200)


def _tlog(folder: Path) -> Target:
    read = _vehicle_log(tlog, folder / "fuzzed.tlog")
    return Target("tlog", [_telemetry()], lambda data: read(_with_checksums(data)), (LogError,), 200)


def _telemetry() -> bytes:
    station = Station([1], 1.0)
    station.run(0.4)
    station.send(1, common.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 5.0, 9))
    station.command(1, 512, 148)
    station.command(1, 400, 1)
    station.run(0.4, station.ask)
    return bytes(station.log)


def _packets(log: bytes) -> Iterator[tuple[int, int]]:
    """Yield where each packet of MAVLink 2 in a telemetry log begins and ends, without its stamp and signature."""
    at = log.find(b"\xfd", STAMP_BYTES)
    while 0 <= at < len(log) - 9:
        yield at, at + 12 + log[at + 1]
        at = log.find(b"\xfd", at + 12 + log[at + 1] + 13 * (log[at + 2] & 1) + STAMP_BYTES)


def _with_checksums(log: bytes) -> bytes:
    """Return a telemetry log with the right checksum of each packet: else a changed byte would only cost its packet."""
    repaired = bytearray(log)
    for begin, end in _packets(log):
        kind = ardupilotmega.mavlink_map.get(int.from_bytes(log[begin + 7 : begin + 10], "little"))
        if kind is not None and end <= len(log):
            checksum = ardupilotmega.x25crc(log[begin + 1 : end - 2] + bytes((kind.crc_extra,))).crc
            repaired[end - 2 : end] = checksum.to_bytes(2, "little")
    return bytes(repaired)


# What arrives on the link of a vehicle.

_DATAGRAM_BYTES = 97
_ADDRESSES = (("127.0.0.1", 14540), ("127.0.0.1", 14541), ("10.0.0.1", 14540))


def _frames(_: Path) -> Target:
    ticks = (BEGIN_US // 1_000_000 - EPOCH_UNIX_S) * TICKS_PER_S

    def signing() -> Signing:
        return Signing(bytes(KEY_LENGTH), lambda: ticks)

    log = _telemetry()
    frames = [log[begin:end] for begin, end in _packets(log)]
    signer = signing()
    signed = [signer.sign(frame) for frame in frames if not is_signed(frame)]
    old = common.MAVLink(None, 1, 1)
    heartbeat = common.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3).pack(old, force_mavlink1=True)

    def read(data: bytes) -> object:
        datagrams = [data[at : at + _DATAGRAM_BYTES] for at in range(0, len(data), _DATAGRAM_BYTES)]
        stream, gate = FrameStream(), FrameGate()
        frames = [frame for some in datagrams for frame in stream.feed(some)]
        assert frames == FrameStream().feed(data)
        gate.claims = {1: Claim(), 2: Claim(signing())}
        for number, datagram in enumerate(datagrams):
            now_s = 0.5 * number
            gate.admit(datagram, _ADDRESSES[datagram[-1] % 8 % 3], now_s)
            for claim in gate.claims.values():
                if claim.address is None and claim.candidates:
                    claim.verify(next(iter(claim.candidates)), now_s)
        return [target_system(frame) for frame in frames], [claim.report() for claim in gate.claims.values()]

    valid = [b"".join(frames), b"".join(signed), bytes(heartbeat) * 3 + signed[0]]
    return Target("frames", valid, read, (), 500)


# What a page sends.

_PROOF = "the page's proof"
"""It stands for the right proof in inputs, since the station's nonce is new each time."""
_HOST = b"localhost:8000"


def _websocket(_: Path) -> Target:
    """The messages of a page are the lines of an input."""
    access = Access(Address("127.0.0.1", 8000), "secret")
    mission = engaging("case2")

    async def serve(lines: list[bytes]) -> None:
        broadcast = Broadcast()
        commands = Commands(mission, None, lambda _: None)
        stream = Stream(broadcast, commands)
        gate = AccessGate(live_app([stream]), live_app([stream]), access, ConnectionLimits())
        text, proof, is_closed = "", "", False
        end: Message = {"type": "websocket.disconnect", "code": 1000}
        left: Iterator[Message] = iter([{"type": "websocket.connect"}, *map(_sent, lines)])

        async def receive() -> Message:
            nonlocal text
            message = next(left, end)
            text = message.get("text", "").replace(_PROOF, proof)
            return {**message, "text": text} if text else message

        async def send(message: Message) -> None:
            nonlocal proof, is_closed
            is_closed |= message["type"] == "websocket.close"
            answer = msgspec.json.decode(message.get("text") or "{}")
            if answer.get("kind") == "challenge":
                proof = access.proof("page", msgspec.json.decode(text, type=Hello).nonce, answer["nonce"])

        scope = {"type": "websocket", "path": "/stream", "headers": [(b"host", _HOST)], "client": ("127.0.0.1", 9)}
        await gate(scope, receive, send)
        assert is_closed or next(left, None) is None, "the connection ended without a reason"

    entered = ['{"kind":"hello","nonce":"0123"}', f'{{"kind":"proof","proof":"{_PROOF}"}}']
    command = '{"kind":"command","request":"a1","verb":"kill","vehicles":[1,2],"confirmation":"kill"}'
    taken_back = '{"kind":"command","request":"a2","verb":"resume","vehicles":null,"overrides_pilot":true}'
    lines = [*entered, command, command, taken_back, '{"kind":"recovered","vehicle_id":2}']
    valid = ["\n".join(lines).encode(), "\n".join(entered).encode(), b'{"kind":"hello","nonce":"0123"}\n{}']
    return Target("websocket", valid, lambda data: asyncio.run(serve(data.split(b"\n"))), (), 300)


def _sent(line: bytes) -> dict[str, Any]:
    """Return a message of a page: a text, or what is none."""
    if line.startswith(b"\xff"):
        return {"type": "websocket.receive", "bytes": line}
    return {"type": "websocket.receive", "text": line[:REQUEST_MAX_BYTES].decode(errors="replace")}


TARGETS: dict[str, Callable[[Path], Target]] = {
    "bus": _bus,
    "container": _container,
    "dataflash": _dataflash,
    "frames": _frames,
    "mission": _mission,
    "profile": _profile,
    "roster": _roster,
    "sensor": _sensor,
    "tlog": _tlog,
    "ulog": _ulog,
    "websocket": _websocket,
    "zones": _zones,
}
