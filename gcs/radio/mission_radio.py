"""The emulated radio between a mission's stub vehicles and the urls of the mission."""

import socket
from collections.abc import Mapping
from urllib.parse import urlsplit

from gcs.errors import InputError
from gcs.mission.mission import Mission
from gcs.radio.emulation import TERMINAL, Emulation
from sitl.radio.channel import Air
from sitl.radio.spec import RadioSpec

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
