"""Vehicles behind emulated radios: serial lines that are pseudo terminals, and one line for several vehicles."""

import asyncio
import json
import re
import select
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from agents.ports import Setpoint, VehicleRefusedError
from agents.shell.clock import WallClock
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Telemetry
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.ports import free_ports
from gcs.link.rates import RateController, Rates
from gcs.link.relay.carriers import Carrier, open_carrier
from gcs.link.relay.frames import FrameStream, station_heartbeat
from gcs.radio.emulation import Emulation, run
from sitl.radio import RadioSpec
from sitl.server.process import StubProcess
from sitl.server.server import StubConfig
from tests.conftest import RunHere
from tests.support.result_keys import OUTPUT_KEYS
from tests.support.wire import LOOPBACK, PATIENCE_S, cordon, until

pytestmark = pytest.mark.wire

PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(0.8, 0.87))
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0))
BAUD = 115200


@contextmanager
def emulated(spec: RadioSpec, station: str, *vehicles: str) -> Iterator[Emulation]:
    """Run a radio in a thread."""
    emulation, ended = Emulation(spec, station, vehicles), Event()
    thread = Thread(target=run, args=([emulation], ended.is_set, lambda: None))
    thread.start()
    try:
        yield emulation
    finally:
        ended.set()
        thread.join()
        emulation.close()


def received(carrier: Carrier, sent: list[bytes], within_s: float) -> list[bytes]:
    """Return which of the frames arrive; the radio's own do as well."""
    stream, frames, end_s = FrameStream(), list[bytes](), time.monotonic() + within_s
    while len(frames) < len(sent) and time.monotonic() < end_s:
        select.select(carrier.watched(), (), (), 0.1)
        for data, _ in carrier.receive():
            frames += [frame for frame in stream.feed(data) if frame in sent]
    return frames


def test_bytes_go_through_serial_lines_both_ways_at_their_rate(tmp_path: Path) -> None:
    station, vehicle = tmp_path / "station", tmp_path / "vehicle"
    sent = [station_heartbeat(number) for number in range(60)]
    with emulated(RadioSpec(baud=9600, latency_ms=50.0, buffer_bytes=4096), f"pty:{station}", f"pty:{vehicle}"):
        ends = [open_carrier(f"serial://{path}:9600") for path in (station, vehicle)]
        for here, there in (ends, ends[::-1]):
            began_s = time.monotonic()
            assert here.known is not None
            assert all(here.send(frame, here.known) for frame in sent)
            assert received(there, sent, PATIENCE_S) == sent
            # A busy computer is slower: tests/sitl/radio/test_channel.py measures the rate without a clock.
            assert time.monotonic() - began_s >= len(b"".join(sent)) * 10 / 9600 + 0.05 - 0.03
        for end in ends:
            end.close()
    assert not station.exists()
    assert not station.is_symlink()


def test_a_place_that_is_taken_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(FileExistsError):
        Emulation(RadioSpec(), f"pty:{tmp_path}/file", ["udpin://127.0.0.1:0"])
    assert (tmp_path / "file").read_text() == "mine"


@asynccontextmanager
async def on_one_line(
    place: Path, spec: RadioSpec, pace: RateController, *system_ids: int
) -> AsyncIterator[tuple[list[MavsdkLink], list[list[Telemetry]], Emulation]]:
    """Serve stubs on one serial line, and connect to all of them."""
    ports = free_ports(len(system_ids))
    stubs = StubProcess(
        [StubConfig(i, port, PLANT, FRAME) for i, port in zip(system_ids, ports, strict=True)], partial(WallClock, 1.0)
    )
    stubs.start()
    hub, told = MavsdkHub(), [list[Telemetry]() for _ in system_ids]
    url = f"serial://{place}:{BAUD}"
    try:
        with emulated(spec, f"pty:{place}", *(f"udpin://{LOOPBACK}:{port}" for port in ports)) as radio:
            links = [MavsdkLink(hub, LinkConfig(url, i, FRAME, pace), WallClock()) for i in dict.fromkeys(system_ids)]
            await asyncio.gather(*(link.connect(each.append) for link, each in zip(links, told, strict=False)))
            yield links, told, radio
            for link in links:
                await link.close()
    finally:
        await hub.close()
        stubs.stop()


async def test_three_vehicles_share_a_line_at_the_rates_and_bytes_that_were_planned(tmp_path: Path) -> None:
    spec = RadioSpec(baud=BAUD, latency_ms=150.0, loss=0.02, shared=True)
    pace = RateController(Rates(telemetry_hz=10.0, status_hz=1.0, setpoint_hz=10.0), 3, BAUD / 10.0)
    async with on_one_line(tmp_path / "line", spec, pace, 1, 2, 3) as (links, told, radio):

        async def fly(during_s: float) -> None:
            began_s = time.monotonic()
            while (since_s := time.monotonic() - began_s) < during_s:
                for link in links:
                    link.send(Setpoint((0.0, 0.0, 5.0 + 0.01 * since_s)))
                await asyncio.sleep(0.02)  # more often than the setpoint rate

        def counts() -> list[int]:
            down = sum(each.sent_bytes for each in radio.down)
            return [radio.up[0].sent_bytes, down, *(len(each) for each in told)]

        planned = [pace.load.up_bytes_s, pace.load.down_bytes_s, *[10.0 * 0.98] * 3]
        await settles(counts, planned, fly)

        def trips_s() -> list[float]:
            return [link.status.round_trip_s or 0.0 for link in links]

        # 150 ms each way, and what waits: 0.18 s more each way on a full line, which it was until the rates were set.
        # That counts for half a minute.
        await until(lambda: all(0.3 <= trip_s <= 0.45 for trip_s in trips_s()), PATIENCE_S, "the round trip")
        assert not any(link.report.doubled for link in links)
        silent = LinkConfig(f"serial://{tmp_path}/line:{BAUD}", 9, FRAME, pace, heartbeat_timeout_s=1.0)
        with pytest.raises(VehicleRefusedError, match="no heartbeat"):  # it does not name the others: they belong here
            await MavsdkLink(links[0]._hub, silent, WallClock()).connect(lambda _: None)
        assert all(link.status.connected for link in links)


async def settles(
    counts: Callable[[], list[int]], planned_per_s: list[float], fly: Callable[[float], Awaitable[None]] = asyncio.sleep
) -> None:
    """Wait until all counts rise as planned, by the medians over windows of 4 s.

    A busy computer delays in one window what arrives in the next.
    """
    end_s, windows, median = time.monotonic() + PATIENCE_S, list[list[float]](), list[float]()
    while time.monotonic() < end_s:
        before, began_s = counts(), time.monotonic()
        await fly(4.0)
        took_s = time.monotonic() - began_s
        windows.append([(after - earlier) / took_s for after, earlier in zip(counts(), before, strict=True)])
        median = np.median(windows[-5:], axis=0).tolist()
        if median == pytest.approx(planned_per_s, rel=0.1):
            return
    pytest.fail(f"{median} per second instead of {planned_per_s}")


async def test_two_vehicles_with_one_id_on_one_line_are_noticed(tmp_path: Path) -> None:
    pace = RateController(Rates(telemetry_hz=10.0, status_hz=1.0, setpoint_hz=10.0), 2, BAUD / 10.0)
    async with on_one_line(tmp_path / "line", RadioSpec(baud=BAUD), pace, 1, 1) as ((link,), _, _):
        await until(lambda: link.report.doubled)


def test_the_command_counts_until_it_is_ended_and_removes_its_devices(tmp_path: Path) -> None:
    station, vehicle = tmp_path / "station", tmp_path / "vehicle"
    with cordon("relay", f"pty:{station}", f"pty:{vehicle}", "--radio", "latency_ms=5", "--json") as relay:
        end_s = time.monotonic() + PATIENCE_S
        while not vehicle.exists() and time.monotonic() < end_s:
            time.sleep(0.05)
        ends = [open_carrier(f"serial://{path}:57600") for path in (station, vehicle)]
        assert ends[0].known is not None
        ends[0].send(sent := station_heartbeat(1), ends[0].known)
        assert received(ends[1], [sent], PATIENCE_S) == [sent]
        for end in ends:
            end.close()
        relay.send_signal(signal.SIGTERM)
        out, err = relay.communicate(timeout=PATIENCE_S)
    assert relay.returncode == 0
    assert list(json.loads(out)) == OUTPUT_KEYS["relay"].split()
    assert json.loads(out)["up"] == [{"frames": 1, "bytes": 21, "lost": 0, "dropped": 0}]
    assert re.findall(r"│ (to|from) ", err) == ["to", "from"]
    assert not station.is_symlink()


@pytest.mark.parametrize(
    ("arguments", "fault", "code"),
    [
        (("pty:/tmp", "udpin://127.0.0.1:0", "--radio", "loss=0.1"), "the radio did not start", 3),
        (("carrier-pigeon", "udpin://127.0.0.1:0", "--radio", "loss=0.1"), "carrier-pigeon", 2),
        (("udpout://127.0.0.1:9", "udpin://127.0.0.1:0", "--radio", "loss=11"), "--radio.loss", 2),
    ],
)
def test_bad_input_is_named(arguments: tuple[str, ...], fault: str, code: int, run_here: RunHere) -> None:
    ended = run_here("relay", *arguments)
    assert fault in ended.err
    assert ended.code == code


async def test_rates_are_requested_again_where_a_line_loses_requests_and_answers(tmp_path: Path) -> None:
    spec = RadioSpec(baud=BAUD, loss=0.4)
    pace = RateController(Rates(telemetry_hz=10.0, status_hz=1.0, setpoint_hz=10.0), 1, BAUD / 10.0)
    async with on_one_line(tmp_path / "line", spec, pace, 1) as (_, _, radio):
        await settles(lambda: [each.sent_bytes for each in radio.down], [pace.load.down_bytes_s])
