"""MAVLink 2 signing against pymavlink's, and the frames that bytes are cut into."""

import secrets
import struct
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs.link.relay.frames import FrameStream, header, is_signed, station_heartbeat
from gcs.link.relay.signing import TICKS_PER_S, SignatureCheck, Signing, SigningTimes, wall_ticks

KEY, OTHER_KEY = secrets.token_bytes(32), secrets.token_bytes(32)
NOW = 30_000_000_000_000
MINUTE = 6_000_000
ANY_MESSAGE = st.one_of(
    st.builds(mavlink.MAVLink_statustext_message, st.just(6), st.binary(max_size=50)),
    st.builds(mavlink.MAVLink_file_transfer_protocol_message, *[st.just(1)] * 3, st.binary(min_size=251, max_size=251)),
    st.builds(
        mavlink.MAVLink_heartbeat_message, *[st.integers(0, 255)] * 3, st.integers(0, 2**32 - 1), *[st.just(3)] * 2
    ),
)


def station(key: bytes | None, system: int = 245, time: int = NOW) -> mavlink.MAVLink:
    end = mavlink.MAVLink(None, system, 1)
    end.robust_parsing = True
    end.signing.secret_key, end.signing.timestamp = key, time
    return end


def heartbeat(sender: mavlink.MAVLink, **options: bool) -> bytes:
    return bytes(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(sender, **options))


def signed(sender: mavlink.MAVLink, count: int = 1) -> list[bytes]:
    sender.signing.sign_outgoing = True
    return [heartbeat(sender) for _ in range(count)]


@given(ANY_MESSAGE)
def test_what_is_signed_here_pymavlink_verifies(message: mavlink.MAVLink_message) -> None:
    frame = Signing(KEY, lambda: NOW).sign(message.pack(station(None)))
    (received,) = station(KEY).parse_buffer(frame)
    assert received.get_type() == message.get_type(), received
    assert received.get_signed()
    assert [each.get_type() for each in station(OTHER_KEY).parse_buffer(frame)] == ["BAD_DATA"]


def test_what_pymavlink_signs_is_accepted_once_and_in_order() -> None:
    signing, (first, second, third) = Signing(KEY, lambda: NOW), signed(station(KEY, 1), 3)
    verdicts = [signing.verify(frame) for frame in (first, third, second, third, first)]
    assert verdicts == [SignatureCheck.AUTHENTIC] * 2 + [SignatureCheck.OLD] * 3


def test_what_is_unsigned_damaged_or_of_another_key_is_not() -> None:
    signing, (frame,) = Signing(KEY, lambda: NOW), signed(station(KEY, 1))
    assert signing.verify(signed(station(OTHER_KEY, 1))[0]) is SignatureCheck.WRONG_KEY
    assert signing.verify(heartbeat(station(None, 1))) is SignatureCheck.UNSIGNED
    for place in range(3, len(frame)):
        damaged = frame[:place] + bytes((frame[place] ^ 1,)) + frame[place + 1 :]
        assert signing.verify(damaged) is SignatureCheck.WRONG_KEY, place
    assert signing.verify(frame) is SignatureCheck.AUTHENTIC, "a forged frame barred the true one"


@pytest.mark.parametrize(
    ("behind", "verdict"), [(MINUTE - 1, SignatureCheck.AUTHENTIC), (MINUTE + 1, SignatureCheck.OLD)]
)
def test_a_stream_begins_at_most_a_minute_ago(behind: int, verdict: SignatureCheck) -> None:
    assert Signing(KEY, lambda: NOW).verify(signed(station(KEY, 1, NOW - behind))[0]) is verdict


def time_of(frame: bytes) -> int:
    low, high = struct.unpack("<IH", frame[-12:-6])
    return int(low + (high << 32))


def test_times_grow_from_run_to_run_and_behind_a_vehicle_that_is_ahead() -> None:
    frame = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(station(None))
    clock = iter((NOW, NOW, NOW - 1000, NOW + 5))
    signing = Signing(KEY, lambda: next(clock))
    times = [time_of(signing.sign(frame)) for _ in range(4)]
    assert times == [NOW, NOW + 1, NOW + 2, NOW + 5]
    later = Signing(KEY, lambda: NOW)
    later.verify(signed(station(KEY, 1, NOW + 10 * MINUTE))[0])
    assert time_of(later.sign(frame)) == NOW + 10 * MINUTE + 1


@given(st.data())
def test_frames_are_found_however_their_bytes_are_split(data: st.DataObject) -> None:
    sender = station(KEY, 7)
    frames = [*signed(sender, 2), heartbeat(sender, force_mavlink1=True)]
    noise = data.draw(st.binary(max_size=20).map(lambda text: text.replace(b"\xfd", b"").replace(b"\xfe", b"")))
    whole = noise + b"".join(frames)
    cuts = sorted(data.draw(st.sets(st.integers(0, len(whole)), max_size=5)))
    stream = FrameStream()
    found = [frame for part in parts(whole, cuts) for frame in stream.feed(part)]
    assert found == frames
    assert [tuple(header(frame)) for frame in found] == [(7, 1, 0)] * 3
    assert [is_signed(frame) for frame in found] == [True, True, False]


def parts(whole: bytes, cuts: Iterable[int]) -> Iterable[bytes]:
    start = 0
    for cut in (*cuts, len(whole)):
        yield whole[start:cut]
        start = cut


def test_the_station_s_own_heartbeat_is_one_to_pymavlink() -> None:
    (message,) = mavlink.MAVLink(None).parse_buffer(station_heartbeat(257))
    assert message.get_type() == "HEARTBEAT"
    assert (message.type, message.autopilot, message.get_srcSystem(), message.get_seq()) == (6, 8, 245, 1)


@given(st.binary(max_size=2000))
def test_any_bytes_are_cut_without_an_error(noise: bytes) -> None:
    stream = FrameStream()
    found = stream.feed(noise)
    assert sum(map(len, found)) <= len(noise)
    assert all(len(frame) <= 280 for frame in found)
    assert len(stream._rest) < 280


def test_what_was_accepted_in_one_run_is_refused_in_the_next(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    now = wall_ticks()
    vehicle, times = station(KEY, 1, now - MINUTE // 2), SigningTimes()
    first, second = signed(vehicle, 2)
    assert times.signing(KEY).verify(first) is SignatureCheck.AUTHENTIC
    assert times.signing(KEY) is times.signing(KEY)
    times.save()
    assert SigningTimes().signing(KEY).verify(first) is SignatureCheck.OLD
    assert SigningTimes().signing(KEY).verify(second) is SignatureCheck.OLD, "accepted after it was saved last"
    vehicle.signing.timestamp += 2 * TICKS_PER_S
    assert SigningTimes().signing(KEY).verify(*signed(vehicle)) is SignatureCheck.AUTHENTIC
    assert SigningTimes().signing(OTHER_KEY).ahead_s < 0.0, "each key has its own"
    path = SigningTimes.path(KEY)
    assert path.stat().st_mode & 0o077 == path.parent.stat().st_mode & 0o077 == 0
    assert KEY.hex()[:12] not in f"{path}{path.read_text()}"
    path.write_text("damaged")
    assert SigningTimes().signing(KEY).verify(second) is SignatureCheck.AUTHENTIC, "as a new stream"


def test_a_clock_that_was_set_back_locks_no_vehicle_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    vehicle, times = station(KEY, 1, wall_ticks() + 60 * MINUTE), SigningTimes()
    assert times.signing(KEY).verify(*signed(vehicle)) is SignatureCheck.AUTHENTIC
    times.save()
    signing, behind = SigningTimes().signing(KEY), station(KEY, 1, wall_ticks())
    assert 3590.0 < signing.ahead_s < 3610.0
    assert signing.verify(*signed(behind)) is SignatureCheck.OLD
    # What is sent to it sets its time.
    assert behind.parse_buffer(signing.sign(heartbeat(station(None))))[0].get_signed()
    assert signing.verify(*signed(behind)) is SignatureCheck.AUTHENTIC
