"""Runs an emulated radio until Ctrl-C, with its counts on a terminal."""

import socket
import threading
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from urllib.parse import urlsplit

from rich.live import Live
from rich.table import Table

from gcs.console.terminal import STDERR
from gcs.errors import Fault, InputError
from gcs.metrics.json_output import json_output
from gcs.mission.mission import Mission
from gcs.mission.validation import shown, validated
from gcs.radio.emulation import TERMINAL, Emulation, run
from gcs.signals import pending
from sitl.radio import Air, Counts, RadioSpec

LOOPBACK = "127.0.0.1"


def free_ports(mission: Mission) -> dict[int, int]:
    """Return a free UDP port for each vehicle, by its id, to which its stub sends."""
    sockets = {vehicle.id: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for vehicle in mission.vehicles}
    for each in sockets.values():
        each.bind((LOOPBACK, 0))
    ports = {vehicle_id: int(each.getsockname()[1]) for vehicle_id, each in sockets.items()}
    for each in sockets.values():
        each.close()
    return ports


def station_places(mission: Mission) -> dict[str, list[int]]:
    """Return the station's connections and the vehicles on each; raises InputError for urls that are not supported."""
    places: dict[str, list[int]] = {}
    faults = []
    for index, vehicle in enumerate(mission.vehicles):
        url = urlsplit(vehicle.section.url)
        if url.scheme == "udpin":
            place = f"udpout://{LOOPBACK}:{url.port}"
        elif url.scheme == "serial":
            place = TERMINAL + vehicle.section.url.removeprefix("serial://").rpartition(":")[0]
        else:
            faults.append(f"vehicles[{index}].url: a radio takes udpin and serial (given: {vehicle.section.url!r})")
            continue
        places.setdefault(place, []).append(vehicle.id)
    if faults:
        raise InputError(faults)
    return places


def mission_radio(spec: RadioSpec, mission: Mission, ports: Mapping[int, int]) -> list[Emulation]:
    """Open a radio for each url of the mission, all on one channel if `shared`; raises OSError for used addresses."""
    air, opened = Air(spec.bytes_s), list[Emulation]()
    try:
        for number, (place, ids) in enumerate(station_places(mission).items()):
            vehicles = [f"udpin://{LOOPBACK}:{ports[vehicle_id]}" for vehicle_id in ids]
            opened.append(Emulation(spec.model_copy(update={"seed": spec.seed + number}), place, vehicles, air))
    except OSError:
        for each in opened:
            each.close()
        raise
    return opened


def counts_json(emulations: Sequence[Emulation], duration_s: float) -> str:
    """Return the counts of both directions as one JSON object."""
    counts = {
        "duration_s": duration_s,
        "up": [_json(counts) for each in emulations for counts in each.up],
        "down": [_json(counts) for each in emulations for counts in each.down],
    }
    return json_output(counts)


def _json(counts: Counts) -> dict[str, int]:
    return {
        "frames": counts.sent_frames,
        "bytes": counts.sent_bytes,
        "lost": counts.lost_frames,
        "dropped": counts.dropped_frames,
    }


def counts_table(emulations: Sequence[Emulation], duration_s: float) -> Table:
    """Return the counts of both directions, and the mean bytes per second since the start."""
    table = Table(title="radio", title_style="bold")
    for column in ("direction", "connection"):
        table.add_column(column, overflow="fold")
    for column in ("frames", "bytes/s", "lost", "dropped"):
        table.add_column(column, justify="right")
    rows = [("to", place, counts) for each in emulations for place, counts in zip(each.groups, each.up, strict=True)]
    rows += [
        ("from", place, counts) for each in emulations for place, counts in zip(each.places, each.down, strict=True)
    ]
    for direction, place, counts in rows:
        rate = counts.sent_bytes / duration_s if duration_s else 0.0
        numbers = (counts.sent_frames, round(rate), counts.lost_frames, counts.dropped_frames)
        table.add_row(direction, place, *map(str, numbers))
    return table


def radio_spec(text: str) -> RadioSpec:
    """Parse `--radio`; raises InputError with every fault."""
    option = "--radio"
    content: dict[str, object] = {}
    faults: list[Fault] = []
    for part in text.split(","):
        key, equals, value = (each.strip() for each in part.partition("="))
        if not key.isidentifier() or (equals and not value):
            faults.append(Fault(option, f"{shown(part)} is not like latency_ms=60"))
        elif key in content:
            faults.append(Fault(f"{option}.{key}", "it is given twice"))
        else:
            content[key] = _value(value) if equals else True
    spec = validated(RadioSpec, content, option, faults)
    if spec is None or faults:
        raise InputError(faults)
    return spec


def _value(text: str) -> object:
    """Return a number or a boolean; any other text unchanged, which no key accepts."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def serve_until_ctrl_c(emulations: Sequence[Emulation]) -> str:
    """Run radios until SIGINT or SIGTERM; return their counts as JSON."""
    began_s = time.monotonic()
    try:
        with Live(console=STDERR, auto_refresh=False, transient=True) as live:

            def show() -> None:
                if STDERR.is_terminal:
                    live.update(counts_table(emulations, time.monotonic() - began_s), refresh=True)

            run(emulations, pending, show)
    finally:
        for each in emulations:
            each.close()
    duration_s = time.monotonic() - began_s
    STDERR.print(counts_table(emulations, duration_s))
    return counts_json(emulations, duration_s)


@contextmanager
def running_beside(emulations: Sequence[Emulation]) -> Iterator[None]:
    """Run radios in a separate thread inside this context; print their counts at the end."""
    ended, began_s = threading.Event(), time.monotonic()
    thread = threading.Thread(target=run, args=(emulations, ended.is_set, lambda: None), name="radio", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        for each in emulations:
            each.close()
        STDERR.print(counts_table(emulations, time.monotonic() - began_s))
