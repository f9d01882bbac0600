"""The server of the operator's page over real sockets: who may open it, and what one page does to the others."""

import asyncio
import gzip
import json
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
import websockets

from agents.ports import VehicleRefusedError
from gcs.keys.certificates import CertificateAuthority
from gcs.mission.file import load_mission
from gcs.station.access import FAILED_DELAY_S, checked_access
from gcs.station.picture import FlightPicture, OperatorRights, TeamPicture
from gcs.station.server import RECORDED, REQUEST_MAX_BYTES, listen, recorded_app, serve
from gcs.viewer import connections
from gcs.viewer.origin_gate import Address
from tests.support.page.station import (
    CannedSource,
    RefusedPageError,
    Station,
    asked,
    received,
    station,
    stream,
    tickets,
)
from tests.support.wire import LOOPBACK, PATIENCE_S, free_port, until

pytestmark = pytest.mark.wire

INDEX = b"<!doctype html>the page"


@pytest.fixture
def page_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "page"
    folder.mkdir()
    (folder / "index.html").write_bytes(INDEX)
    return folder


@pytest.fixture
async def served(mission_file: Callable[..., str], page_folder: Path) -> AsyncIterator[Station]:
    async with station(load_mission(mission_file("case2")), page_folder) as running:
        yield running


async def test_a_page_is_shown_the_mission_then_what_comes_and_a_late_one_the_latest(served: Station) -> None:
    for number in range(250):
        served.source.event(f"event {number}")
    served.source.team(1.0)
    served.source.team(2.0)
    async with served.connected() as page:
        first = json.loads(await page.recv())
        assert (first["kind"], first["mission"]) == ("mission", "canned")

        async def following() -> dict[str, Any]:
            """Return what comes next but a mission: it comes again once it is known why a page is read-only."""
            while (message := json.loads(await page.recv()))["kind"] == "mission":
                pass
            return message  # type: ignore[no-any-return]

        newest = await following()
        assert (newest["kind"], newest["time_s"]) == ("team", 2.0)
        events = [await following() for _ in range(200)]
        assert [event["text"] for event in events] == [f"event {number}" for number in range(50, 250)]
        assert [event["number"] for event in events] == list(range(51, 251))
        served.source.team(3.0)
        served.source.event("the next")
        assert (await following())["time_s"] == 3.0
        assert (await following())["text"] == "the next"


async def test_a_stranger_gets_no_stream(served: Station) -> None:
    for origin, host, why in (
        ("https://evil.example", "", "another page"),
        ("null", "", "a page in a frame without an origin"),
        ("http://localhost:1", "", "another server of this computer"),
        (f"http://evil.example:{served.port}", f"evil.example:{served.port}", "a name that was bound to here"),
    ):
        with pytest.raises(RefusedPageError, match="403"):
            async with served.connected(Origin=origin, **({"Host": host} if host else {})):
                pytest.fail(why)


async def test_a_page_that_does_not_know_the_secret_gets_nothing_and_who_knows_it_does_not_wait(
    served: Station, subtests: pytest.Subtests
) -> None:
    """Wrong proofs wait for longer and longer, each connection for itself; a right one from the same host enters."""
    with subtests.test("without a proof"):
        async with websockets.connect(stream_url(served), proxy=None) as page:
            await page.send(asked("1", "kill", confirmation="kill"))
            with pytest.raises(websockets.ConnectionClosed):
                print(await page.recv())
    with subtests.test("proofs of others"):
        async with served.connected() as entered, websockets.connect(stream_url(served), proxy=None) as page:
            await page.send('{"kind": "hello", "nonce": "a nonce"}')
            challenge = json.loads(await page.recv())
            await page.send(json.dumps({"kind": "proof", "proof": challenge["proof"]}))  # the station's own
            with pytest.raises(websockets.ConnectionClosed):
                print(await page.recv())
            assert entered.state is websockets.State.OPEN
    with subtests.test("tries in a row"):
        began_s = time.monotonic()
        for _ in range(4):
            with pytest.raises(RefusedPageError, match="1008"):
                async with served.connected("another secret"):
                    pass
        assert time.monotonic() - began_s > 4 * FAILED_DELAY_S
    with subtests.test("while others wait"):
        attack = [asyncio.create_task(tried(served)) for _ in range(40)]
        async with served.connected() as page:
            await received(page, "mission")
        for each in attack:
            each.cancel()
        await asyncio.gather(*attack, return_exceptions=True)


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\n", b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"])
async def test_connections_of_strangers_do_not_keep_pages_out(served: Station, sent: bytes) -> None:
    """Also those that begin a request, or send one and stay: more than a computer opens for a page."""
    async with served.connected() as first, AsyncExitStack() as opened:
        await received(first, "mission")
        for _ in range(300):
            _, writer = await asyncio.open_connection(LOOPBACK, served.port)
            opened.callback(writer.close)
            writer.write(sent)
        for _ in range(3):
            assert (await served.get("/"))[0] == 200
            async with served.connected() as page:
                await received(page, "mission")
        served.source.team(1.0)
        assert (await received(first, "team"))["time_s"] == 1.0


@pytest.mark.parametrize("is_secure", [False, True])
async def test_connections_that_do_not_enter_end_by_themselves(
    is_secure: bool, tmp_path: Path, page_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tls = None
    if is_secure:
        keys = CertificateAuthority.made(1.0).issue("station", 4e9)
        tls = (tmp_path / "certificate.pem", tmp_path / "key.pem")
        tls[0].write_bytes(keys.certificate_pem)
        tls[1].write_bytes(keys.private_key_pem)
        tls[1].chmod(0o600)
    monkeypatch.setattr(connections, "SILENT_MAX_S", 0.5)
    monkeypatch.setattr(connections, "ASKED_MAX_S", 0.5)
    access = checked_access(Address(LOOPBACK, free_port()), None, tls)
    stop = asyncio.Event()
    flight = FlightPicture(CannedSource().mission(OperatorRights()), (), ())
    serving = asyncio.create_task(serve(recorded_app(flight), access, listen(access), stop, page_folder))
    opened = [await asyncio.open_connection(LOOPBACK, access.address.port) for _ in range(8)]
    async with asyncio.timeout(PATIENCE_S):
        for reader, _ in opened:
            with suppress(ConnectionResetError):
                assert await reader.read() == b""
        if not is_secure:
            async with websockets.connect(f"ws://{LOOPBACK}:{access.address.port}/stream", proxy=None) as page:
                await page.wait_closed()
    if not is_secure:
        async with stream(access.address.port, access.secret) as page:
            await asyncio.sleep(1.0)  # longer than others may stay
            await asyncio.wait_for(await page.ping(), PATIENCE_S)
    stop.set()
    await asyncio.wait_for(serving, PATIENCE_S)


def stream_url(served: Station) -> str:
    return f"ws://{LOOPBACK}:{served.port}/stream"


async def tried(served: Station) -> None:
    while True:
        with suppress(RefusedPageError, websockets.ConnectionClosed, OSError):
            async with served.connected("another secret"):
                pass


async def test_files_are_served_with_headers_that_keep_others_out(served: Station, subtests: pytest.Subtests) -> None:
    with subtests.test("the page"):
        status, headers, body = await served.get("/")
        assert (status, body) == (200, INDEX)
        policy = dict(part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";"))
        assert policy["script-src"] == policy["worker-src"] == policy["connect-src"] == "'self'"
        assert policy["default-src"] == policy["frame-ancestors"] == "'none'"
        assert "unsafe" not in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"
    with subtests.test("names"):
        for host in ("evil.example", "", f"localhost.evil.example:{served.port}", "[::1"):
            assert (await served.get("/", Host=host))[0] == 403, host
        assert (await served.get("/", Host="localhost:9999"))[0] == 200, "a forwarded port"
    with subtests.test("origin"):
        assert (await served.get("/", Origin="https://evil.example"))[0] == 403
    with subtests.test("without a ticket: they hold no secret"):
        assert (await served.get("/flight.json"))[0] == 404
        assert "Set-Cookie" not in headers
    with subtests.test("nothing outside of the folder"):
        assert (await served.get("/../mission.toml"))[0] == 404
        assert (await served.get("/%2e%2e/mission.toml"))[0] == 404


async def test_a_page_that_says_what_it_should_not_is_closed_alone(served: Station) -> None:
    said: dict[str | bytes, int] = {
        "{": 1007,
        '{"":' + "[" * 1200: 1007,
        b"\x00\x01": 1007,
        asked("1", "dance"): 1007,
        asked("1", "hold", more=1): 1007,
        asked("x" * REQUEST_MAX_BYTES, "hold"): 1009,
    }
    async with served.connected() as other:
        for number, (text, code) in enumerate(said.items()):
            async with served.connected() as page:
                await page.send(text)
                await asyncio.wait_for(page.wait_closed(), PATIENCE_S)
                assert page.close_code == code
            served.source.team(float(number))
            assert (await received(other, "team"))["time_s"] == number


async def test_without_keys_a_page_is_read_only_and_is_told_why(served: Station) -> None:
    async with served.connected() as page:
        operator = (await received(page, "mission"))["operator"]
        assert (operator["name"], operator["may"]) == ("", [])
        assert "no flight" in operator["read_only"]
        await page.send(asked("1", "hold"))
        assert await received(page, "receipt") == {"kind": "receipt", "request": "1"}
        answer = await received(page, "answer")
        assert (answer["request"], answer["vehicle_id"], answer["is_obeyed"]) == ("1", None, False)
        assert answer["is_final"]
        assert "read-only" in answer["did"]
        assert "no flight" in answer["did"]
        # A flight that is over has none: who stands beside the vehicle has to be able to confirm its recovery.
        await page.send('{"kind": "recovered", "vehicle_id": 3}')
        await until(lambda: served.source.recovered == [3])


async def test_a_slow_page_is_shown_the_newest_and_holds_nobody_up(served: Station) -> None:
    async with served.connected() as quick, served.connected() as slow:
        await received(quick, "mission")
        slow.transport.pause_reading()
        for time_s in range(3000):
            served.source.team(float(time_s), vehicles=32)
            if time_s % 10 == 0:
                await asyncio.sleep(0)
        served.source.team(3000.0)
        while (await received(quick, "team"))["time_s"] < 3000.0:
            pass
        slow.transport.resume_reading()
        shown = 0
        while (await received(slow, "team"))["time_s"] < 3000.0:
            shown += 1
        assert shown < 1500, "pictures were kept for it"


async def test_files_are_compressed_for_a_slow_link(served: Station, page_folder: Path) -> None:
    (page_folder / "library.mjs").write_text("export const number = 1;\n" * 10_000)
    status, headers, body = await served.get("/library.mjs", "GET", **{"Accept-Encoding": "gzip"})
    assert (status, headers["Content-Encoding"]) == (200, "gzip")
    assert len(body) < 10_000
    assert gzip.decompress(body) == (page_folder / "library.mjs").read_bytes()


async def test_pages_that_are_killed_are_gone_and_cost_the_others_nothing(served: Station) -> None:
    async with served.connected() as page:
        for _ in range(2):
            async with AsyncExitStack() as opened:
                pages = [await opened.enter_async_context(served.connected()) for _ in range(40)]
                for each in pages:
                    await received(each, "mission")
                for each in pages:
                    each.transport.abort()
            served.source.team(1.0)
            assert (await received(page, "team"))["time_s"] == 1.0


async def test_a_recorded_flight_is_one_object(page_folder: Path) -> None:
    mission = CannedSource().mission(OperatorRights())
    flight = FlightPicture(mission, tuple(TeamPicture(0.2 * k, 0.0, ()) for k in range(50)), ())
    access = checked_access(Address(LOOPBACK, free_port()), None, None)
    stop = asyncio.Event()
    serving = asyncio.create_task(serve(recorded_app(flight), access, listen(access), stop, page_folder))
    running = Station(access, CannedSource())
    status, headers, body = await running.get_as_page("/flight.json")
    assert (status, headers["Content-Encoding"], headers["Cache-Control"]) == (200, "gzip", "no-store")
    assert msgspec.json.decode(gzip.decompress(body), type=FlightPicture) == flight
    assert (await running.get("/flight.json"))[0] == 404
    async with running.connected() as page:
        assert await page.recv() == RECORDED
        ticket = {"Authorization": f"Bearer {tickets[page]}"}
        assert (await running.get("/flight.json", **ticket))[0] == 200
    assert (await running.get("/flight.json", **ticket))[0] == 404, "a ticket ends with its connection"
    stop.set()
    await asyncio.wait_for(serving, PATIENCE_S)


@pytest.mark.parametrize("host", [LOOPBACK, "::1"])
def test_a_port_that_is_taken_is_refused(host: str) -> None:
    """At either address of loopback: browsers look for the page's name at both."""
    port, family = free_port(), socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        taken = socket.create_server((host, port), family=family)
    except OSError:
        pytest.skip(f"no {host}")
    with taken, pytest.raises(VehicleRefusedError) as refused:
        listen(checked_access(Address(LOOPBACK, port), None, None))
    assert str(port) in refused.value.reason
    assert "--address" in refused.value.next_step
