"""Logs that are cut, damaged, foreign or made up: read as far as they are whole, and honestly; never believed."""

import struct
import time
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer

from agents.inputs import AutopilotStatus, Bus, Start, Tick
from agents.ports import FlightMode, VehicleStatus
from gcs.errors import InputError
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, LogRecord, read_log
from gcs.flightlog.records import FORMAT, Decision, Run, VehicleEnd
from gcs.flightlog.recover import examine, recover, recovered_path
from gcs.flightlog.schema import Codec, Decoder
from tests.conftest import RunHere
from tests.support.flight_logs import engaging, files_up_to, record_simulation

pytestmark = pytest.mark.slow

CHUNK, INDEX, DATA_END, FOOTER = 6, 7, 15, 2
HUGE = 100_000_000_000
MEMORY_MAX_BYTES = 300_000_000
SECONDS_MAX = 20.0
ReadT = TypeVar("ReadT")
FUZZ = settings(max_examples=20)


class Sample(NamedTuple):
    """A whole log: its bytes, what is in it, and a place for what is made of it."""

    data: bytes
    log: FlightLog
    folder: Path

    def written(self, data: bytes) -> Path:
        path = self.folder / "damaged.mcap"
        path.write_bytes(data)
        return path

    @property
    def total(self) -> int:
        return held(self.log)


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    folder = tmp_path_factory.mktemp("sample")
    record_simulation(engaging(), folder / "whole.mcap", duration_s=20.0, flush_s=1.0)
    log = read_log(folder / "whole.mcap")
    assert log.faults == []
    return Sample((folder / "whole.mcap").read_bytes(), log, folder)


def held(log: FlightLog) -> int:
    return len(log.run_records) + sum(map(len, log.vehicles.values()))


def records_of(data: bytes) -> Iterator[tuple[int, int, int]]:
    """The kind, place and length of each record of a file that is whole: an own walk through it."""
    offset = 8
    while offset < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, offset)
        yield kind, offset, length
        offset += 9 + length


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    return [(offset, length) for kind, offset, length in records_of(data) if kind == CHUNK]


def assert_honest(sample: Sample, data: bytes) -> FlightLog | None:
    """A log is refused, or holds nothing that was not written, in order, and says so when that is not all."""
    path = sample.written(data)
    log = or_refused(lambda: read_log(path), f"{path}: ")
    if log is None:
        return None
    for vehicle_id, records in log.vehicles.items():
        written = iter([each.payload for each in sample.log.vehicles[vehicle_id]])
        assert all(any(each.payload == payload for payload in written) for each in records)
    assert log.faults or held(log) == sample.total
    return log


def or_refused(read: Callable[[], ReadT], where: str) -> ReadT | None:
    """Return what is read, None where it is refused: with nothing but a LogError that says where."""
    refusal: LogError | None = None
    try:
        return read()
    except LogError as error:
        refusal = error
    assert all(fault.startswith(where) for fault in refusal.faults)
    return None


def told(log: FlightLog) -> str:
    return "\n".join(log.faults)


# Fuzzed


@FUZZ
@given(share=st.floats(0.0, 1.0, exclude_max=True), head=st.none() | st.integers(0, 60), bit=st.integers(0, 7))
def test_any_flipped_bit_is_noticed(share: float, head: int | None, bit: int, sample: Sample) -> None:
    """Anywhere, or in the head of a record."""
    data = bytearray(sample.data)
    places = [offset for _, offset, _ in records_of(sample.data)]
    at = int(share * len(data)) if head is None else min(places[int(share * len(places))] + head, len(data) - 1)
    data[at] ^= 1 << bit
    log = assert_honest(sample, bytes(data))
    assert log is None or log.faults
    assert log is None or held(log) >= 0.5 * sample.total or not log.vehicles, "the rest is read all the same"


@FUZZ
@given(place=st.floats(0.0, 1.0, exclude_max=True))
def test_cut_anywhere_it_gives_what_mcap_s_own_reader_gives(place: float, sample: Sample) -> None:
    data = sample.data[: int(place * len(sample.data))]
    whole = 0
    with suppress(Exception):  # it ends in one
        for record in StreamReader(BytesIO(data)).records:
            whole += isinstance(record, Message)
    log = assert_honest(sample, data)
    assert (0 if log is None else held(log)) == whole
    assert log is None or ("it was never closed: it ends" in told(log) and not log.is_damaged)


@FUZZ
@given(place=st.floats(0.0, 1.0), inserted=st.binary(min_size=1, max_size=2000))
def test_bytes_that_do_not_belong_there_are_noticed(place: float, inserted: bytes, sample: Sample) -> None:
    at = int(place * len(sample.data))
    log = assert_honest(sample, sample.data[:at] + inserted + sample.data[at:])
    assert log is None or log.faults
    assert log is None or held(log) >= 0.5 * sample.total


@given(record=st.floats(0.0, 1.0, exclude_max=True), place=st.floats(0.0, 1.0), new=st.binary(max_size=12))
def test_a_record_whose_bytes_are_not_its_own_is_refused_by_name(
    record: float, place: float, new: bytes, sample: Sample
) -> None:
    records = [each for each in sample.log.vehicles[2] if each.kind is not Tick]
    kind, time_ns, payload, decoder = records[int(record * len(records))]
    at = int(place * len(payload))
    damaged = LogRecord(kind, time_ns, payload[:at] + new + payload[at + len(new) :], decoder)
    or_refused(lambda: damaged.read(kind), f"{sample.log.path}: /vehicle/2/")
    or_refused(damaged.message, f"{sample.log.path}: /vehicle/2/")


# Damages as they come


def test_a_damaged_chunk_costs_its_records_which_are_told_and_the_exit_code_says_so(
    sample: Sample, run_here: RunHere
) -> None:
    offset, length = chunks_of(sample.data)[8]
    lost = [each for each in _messages(sample.data, 8) if each.topic.startswith("/vehicle/2/")]
    every = [each for which in range(len(chunks_of(sample.data))) for each in _messages(sample.data, which)]
    data = bytearray(sample.data)
    data[offset + length // 2] ^= 0x10
    log = assert_honest(sample, bytes(data))
    assert log is not None
    assert log.is_damaged
    assert held(log) == sample.total - len(_messages(sample.data, 8))
    assert f"at byte {offset}: a chunk" in told(log)
    of_vehicle = [each for each in every if each.topic.startswith("/vehicle/2/")]
    first = of_vehicle.index(lost[0])
    begin_s, end_s = ((of_vehicle[at].time_ns - every[0].time_ns) / 1e9 for at in (first - 1, first + len(lost)))
    missing = f"vehicle 2: {len(lost)} records are missing, between {begin_s:.1f} and {end_s:.1f} s of the log"
    assert missing in told(log)
    assert len(lost) > 30
    for command in (("replay",), ("report",), ("log", "recover")):
        code, _, said = run_here(*command, str(log.path))
        assert code == 1
        assert f"{held(log)} records of " in " ".join(said.split()), command


def test_a_chunk_whose_length_or_kind_is_damaged_costs_that_chunk(subtests: pytest.Subtests, sample: Sample) -> None:
    for which in [0, 5, -1]:
        for field in ["length", "kind"]:
            with subtests.test(which=which, field=field):
                offset, _ = chunks_of(sample.data)[which]
                data = bytearray(sample.data)
                if field == "length":
                    data[offset + 3] ^= 0x40
                else:
                    data[offset] ^= 0x01
                log = assert_honest(sample, bytes(data))
                assert log is not None, "what was flown is said at both ends"
                assert log.is_damaged
                assert held(log) == sample.total - len(_messages(sample.data, which))


def test_a_chunk_that_passes_for_an_index_is_noticed_by_its_place(sample: Sample) -> None:
    offset, _ = chunks_of(sample.data)[8]
    data = bytearray(sample.data[: chunks_of(sample.data)[12][0]])
    data[offset] = INDEX
    log = assert_honest(sample, bytes(data))
    assert log is not None
    assert f"at byte {offset}: a message index is damaged" in told(log)


def test_an_index_that_is_damaged_costs_no_record(sample: Sample) -> None:
    at = next(offset for kind, offset, _ in records_of(sample.data) if kind == FOOTER) - 20
    log = assert_honest(sample, sample.data[:at] + b"\x00" * 12 + sample.data[at + 12 :])
    assert log is not None
    assert held(log) == sample.total
    assert "its index is damaged" in told(log)


def foreign() -> bytes:
    """Another program's MCAP file."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
    channel = writer.register_channel("/chatter", "ros1", schema)
    writer.add_message(channel, 1, b"hello", 1)
    writer.finish()  # type: ignore[no-untyped-call]  # it takes and returns nothing
    return stream.getvalue()


def test_what_is_no_log_is_refused(subtests: pytest.Subtests, sample: Sample) -> None:
    for data, reason in (
        (b"", "it is empty"),
        (foreign(), "it holds no cordon record"),
        (b"# Flight logs", "it is not an MCAP file"),
        (b"\x89MCAP0\r\n", "it holds no cordon record"),
        (b"\x89MCAP0\r\n" + bytes(10_000_000), "it holds no cordon record"),
    ):
        with subtests.test(reason=reason):
            path = sample.written(data)
            with pytest.raises(LogError, match=reason):
                read_log(path)


# Claims


def record(kind: int, body: bytes, claimed: int | None = None) -> bytes:
    return struct.pack("<BQ", kind, len(body) if claimed is None else claimed) + body


def chunk(packed: bytes, size: int, crc: int = 0, packed_claimed: int | None = None) -> bytes:
    count = len(packed) if packed_claimed is None else packed_claimed
    head = struct.pack("<QQQII", 0, 0, size, crc, 4) + b"zstd" + struct.pack("<Q", count)
    return record(CHUNK, head + packed)


def bomb(size: int) -> bytes:
    """A chunk that is true to its word: it unpacks to zeros, nearly a thousand times its size, checksum and all."""
    data = record(128, bytes(size))
    return chunk(zstandard.compress(data), len(data), zlib.crc32(data))


def sizeless(size: int) -> bytes:
    """A chunk that does not say in its packed data how large that will be."""
    packer = zstandard.ZstdCompressor(write_content_size=False)
    return chunk(packer.compress(bytes(size)), HUGE)


CLAIMS: dict[str, Callable[[], bytes]] = {
    "a record of 100 GB": lambda: record(CHUNK, b"", HUGE),
    "a record that fits the file but no memory": lambda: record(3, b"", 90_000_000),
    "a chunk of 100 GB unpacked": lambda: chunk(zstandard.compress(bytes(1000)), HUGE),
    "a chunk of 2^64 bytes packed": lambda: chunk(zstandard.compress(bytes(1000)), 1000, packed_claimed=2**64 - 1),
    "a chunk that unpacks to more than it says": lambda: chunk(zstandard.compress(bytes(400_000_000)), 1000),
    "a chunk that unpacks without end": lambda: sizeless(400_000_000),
    "a bomb": lambda: bomb(400_000_000),
    "many small bombs": lambda: bomb(30_000_000) * 200,
    "a text of 4 GB": lambda: record(3, struct.pack("<HI", 1, 0xFFFFFFFF) + b"x"),
    "a message index of 4 GB": lambda: record(INDEX, struct.pack("<HI", 1, 0xFFFFFFFF)),
    "an end that is none": lambda: record(DATA_END, bytes(2000)),
    "kinds that nobody knows": lambda: record(200, b"") * 20_000,
    "chunks that only look like chunks": lambda: chunk(b"", HUGE) * 100_000,
}


def test_a_claim_is_not_believed(subtests: pytest.Subtests, sample: Sample) -> None:
    for claim, make in CLAIMS.items():
        with subtests.test(claim=claim):
            begin = chunks_of(sample.data)[3][0]
            inserted = make()
            path = sample.written(sample.data[:begin] + inserted + sample.data[begin:])
            began_s = time.process_time()
            tracemalloc.start()
            try:
                log = read_log(path)
                peak_bytes = tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()
            assert peak_bytes < MEMORY_MAX_BYTES
            assert time.process_time() - began_s < SECONDS_MAX
            assert 1 <= len(log.faults) < 40, "not one for each of a hundred thousand"
            if claim not in ("many small bombs", "chunks that only look like chunks"):  # it gives up
                assert held(log) == sample.total


@pytest.mark.parametrize("more", [-100, 9], ids=["within a record", "in a record that claims it all"])
def test_a_file_of_a_hundred_gigabytes_of_nothing_is_no_matter(more: int, sample: Sample) -> None:
    half = chunks_of(sample.data)[10][0]
    claim = record(CHUNK, b"", HUGE // 2) if more > 0 else b""
    path = sample.written(sample.data[: half + min(more, 0)] + claim)
    try:
        with path.open("r+b") as file:
            file.truncate(HUGE)
    except OSError as error:
        pytest.skip(f"this file system has no holes: {error}")
    began_s = time.process_time()
    log = read_log(path)
    path.unlink()
    assert time.process_time() - began_s < SECONDS_MAX
    assert 0.2 * sample.total < held(log) < sample.total
    assert log.faults


# Other versions


class Wind(msgspec.Struct, frozen=True):
    speed_m_s: float


def made_up(sample: Sample, *more: tuple[str, str, bytes, bytes], run: Run | None = None) -> Path:
    """A log of the sample's run, and of records of (topic, schema's name, schema, payload)."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    records = [entry("/run", run or sample.log.run, 0), *more]
    for at, (topic, name, schema, payload) in enumerate(records):
        number = writer.register_schema(name, "protobuf", schema)
        writer.add_message(writer.register_channel(topic, "protobuf", number), at, payload, at)
    writer.finish()  # type: ignore[no-untyped-call]  # it takes and returns nothing
    return sample.written(stream.getvalue())


def entry(topic: str, item: object, number: int) -> tuple[str, str, bytes, bytes]:
    codec = Codec(type(item))
    return topic, codec.name, codec.schema, codec.encode(item, number)


def test_a_newer_version_s_log_says_so_and_is_read_as_far_as_it_is_known(sample: Sample) -> None:
    newer = msgspec.structs.replace(sample.log.run, format=FORMAT + 1)
    decision = next(each for each in sample.log.vehicles[1] if each.kind is Decision)
    path = made_up(
        sample,
        entry("/vehicle/1/start", Start(1.0), 1),
        entry("/vehicle/1/wind", Wind(3.0), 2),
        with_unknown_word(),
        ("/vehicle/1/decision", "cordon.Decision", Codec(Decision).schema, decision.payload),
        run=newer,
    )
    log = read_log(path)
    assert f"format {FORMAT + 1}; this version reads up to {FORMAT}" in told(log)
    assert "1 records are not read: /vehicle/1/wind is unknown to this version" in told(log)
    assert "1 records of kind AutopilotStatus have content that this version does not support" in told(log)
    assert [each.kind for each in log.vehicles[1]] == [Start, Decision]
    assert log.run == newer
    assert list(log.of_kind(1, Start)) == [Start(1.0)]


def test_a_log_of_a_former_format_is_an_error_that_names_its_version(sample: Sample) -> None:
    former = msgspec.structs.replace(sample.log.run, format=FORMAT - 1)
    with pytest.raises(LogError, match=f"format {FORMAT - 1}.*cordon 0.1.*reads {FORMAT}"):
        read_log(made_up(sample, entry("/vehicle/1/start", Start(1.0), 1), run=former))


def with_unknown_word() -> tuple[str, str, bytes, bytes]:
    """What an autopilot says of itself, in a mode that no version knows."""
    topic, name, schema, payload = entry(
        "/vehicle/1/autopilot", AutopilotStatus(VehicleStatus(mode=FlightMode.HOLD)), 3
    )
    assert b"hold" in payload
    return topic, name, schema, payload.replace(b"hold", b"soar")


def test_a_field_that_this_version_does_not_know_is_no_matter(sample: Sample) -> None:
    later = msgspec.defstruct("Start", [("at_s", float), ("weather", str)])
    log = read_log(made_up(sample, entry("/vehicle/1/start", later(1.0, "fair"), 1)))
    assert list(log.of_kind(1, Start)) == [Start(1.0)]


def test_records_whose_schema_is_not_as_it_must_be_are_left_out_and_told(
    subtests: pytest.Subtests, sample: Sample
) -> None:
    for broken in ["missing", "other form", "damaged", "none"]:
        with subtests.test(broken=broken):
            alive = entry("/vehicle/1/bus", Bus(alive=True), 2)
            topic, name, schema, payload = {
                "missing": entry("/vehicle/1/bus", msgspec.defstruct("Bus", [])(), 2),
                "other form": entry("/vehicle/1/bus", msgspec.defstruct("Bus", [("alive", int)])(1), 2),
                "damaged": (*alive[:2], alive[2][:-5], alive[3]),
                "none": (*alive[:2], b"", alive[3]),
            }[broken]
            log = read_log(made_up(sample, entry("/vehicle/1/start", Start(1.0), 1), (topic, name, schema, payload)))
            assert "1 records are not read: /vehicle/1/bus: " in told(log)
            assert [each.kind for each in log.vehicles[1]] == [Start]


def test_a_record_without_its_number_is_left_out_and_told(sample: Sample) -> None:
    start = entry("/vehicle/1/start", Start(1.0), 1)
    log = read_log(made_up(sample, start, (*start[:3], b"\xff\xff")))
    assert "1 records are damaged" in told(log)
    assert len(log.vehicles[1]) == 1


def test_a_schema_with_maps_is_refused() -> None:
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    file = FileDescriptorProto(name="x.proto", package="cordon", syntax="proto3")
    message = file.message_type.add(name="Start")
    nested = message.nested_type.add(name="WordsEntry")
    nested.options.map_entry = True
    with pytest.raises(ValueError, match="maps"):
        Decoder("cordon.Start", FileDescriptorSet(file=[file]).SerializeToString())


# Recovering


def _nothing(_: float) -> None:
    """Show no progress."""


class Seen(NamedTuple):
    topic: str
    time_ns: int
    published_ns: int
    data: bytes
    schema: tuple[str, bytes] | None


def by_index(path: Path) -> list[Seen]:
    """What mcap's own reader finds by a file's index."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary() is not None
        return [
            Seen(
                channel.topic,
                message.log_time,
                message.publish_time,
                message.data,
                None if schema is None else (schema.name, schema.data),
            )
            for schema, channel, message in reader.iter_messages(log_time_order=False)
        ]


def _messages(data: bytes, which: int) -> list[Seen]:
    """The messages of one chunk of a whole file, as mcap's own reader finds them."""
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    chunks = [each for each in StreamReader(BytesIO(data), emit_chunks=True).records if isinstance(each, Chunk)]
    return [
        Seen(summary.channels[each.channel_id].topic, each.log_time, each.publish_time, each.data, None)
        for each in breakup_chunk(chunks[which])
        if isinstance(each, Message)
    ]


def test_a_log_that_was_never_closed_is_recovered_whole(sample: Sample, tmp_path: Path) -> None:
    end = next(offset for kind, offset, _ in records_of(sample.data) if kind == DATA_END)
    path = tmp_path / "left.mcap"
    path.write_bytes(sample.data[:end])
    recovery = recover(path, tmp_path / "new.mcap", _nothing)
    assert recovery.records == sample.total
    assert recovery.seconds == pytest.approx(20.0, abs=0.2)
    assert len(recovery.faults) == 1
    whole = tmp_path / "whole.mcap"
    whole.write_bytes(sample.data)
    assert by_index(tmp_path / "new.mcap") == by_index(whole)
    assert path.read_bytes() == sample.data[:end], "what was left is as it was"
    assert examine(tmp_path / "new.mcap", _nothing).faults == ()
    assert read_log(tmp_path / "new.mcap").end == sample.log.end


def test_the_command_tells_what_is_recovered_and_overwrites_nothing(
    sample: Sample, tmp_path: Path, run_here: RunHere
) -> None:
    path = tmp_path / "left.mcap"
    path.write_bytes(sample.data[: len(sample.data) // 2])
    code, _, said = run_here("log", "recover", str(path))
    assert code == 0
    new = recovered_path(path)
    assert f"{new}: {held(read_log(new))} records of " in said
    assert "incomplete: it was never closed: it ends" in said
    before = new.read_bytes()
    again, whole = run_here("log", "recover", str(path)), run_here("log", "recover", str(new))
    assert (again.code, whole.code) == (2, 0)
    assert "exists already" in again.err
    assert new.read_bytes() == before
    assert "it is complete" in whole.err


def test_what_cannot_be_recovered_ends_in_exit_code_2_and_leaves_nothing(
    sample: Sample, tmp_path: Path, run_here: RunHere, subtests: pytest.Subtests
) -> None:
    left = sample.data[: len(sample.data) // 2]
    for each, data in (("foreign.mcap", b"PX4"), ("bare.mcap", sample.data[:8]), ("left.mcap", left)):
        (tmp_path / each).write_bytes(data)
    for name, output, reason in (
        ("nowhere.mcap", "new.mcap", "No such file"),
        ("foreign.mcap", "new.mcap", "it is not an MCAP file"),
        ("bare.mcap", "new.mcap", "it holds no cordon record"),
        ("left.mcap", "nowhere/new.mcap", "No such file"),
        ("left.mcap", "left.mcap", "exists already"),
    ):
        with subtests.test(name=name, output=output):
            code, _, said = run_here("log", "recover", str(tmp_path / name), "-o", str(tmp_path / output))
            assert code == 2
            assert reason in said
            assert not (tmp_path / "new.mcap").exists()
            assert (tmp_path / "left.mcap").read_bytes() == left


def test_nothing_is_left_of_a_recovery_whose_disk_is_full(sample: Sample, tmp_path: Path) -> None:
    path = sample.written(sample.data[: len(sample.data) // 2])
    with files_up_to(20_000), pytest.raises(InputError, match="File too large"):
        recover(path, tmp_path / "new.mcap", _nothing)
    assert not (tmp_path / "new.mcap").exists()


def test_a_run_that_ended_before_it_was_known_says_so(sample: Sample) -> None:
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    topic, name, schema, payload = entry("/vehicle/1/end", VehicleEnd(1, 0, None, "landed", ""), 1)
    channel = writer.register_channel(topic, "protobuf", writer.register_schema(name, "protobuf", schema))
    writer.add_message(channel, 1, payload, 1)
    writer.finish()  # type: ignore[no-untyped-call]  # it takes and returns nothing
    with pytest.raises(LogError, match="it holds no record of the run"):
        read_log(sample.written(stream.getvalue()))
