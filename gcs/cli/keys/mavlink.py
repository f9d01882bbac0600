"""`cordon keys issue mavlink`: the signing keys of the vehicles' MAVLink links."""

import asyncio
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from gcs.cli.options import MissionName, chosen_vehicle, loaded_mission
from gcs.errors import Exit, InputError


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MavlinkOptions:
    """Options of `cordon keys issue mavlink`, without the mission."""

    vehicle: Annotated[int | None, Parameter(help="Set up this vehicle only, not all.")] = None


_DEFAULTS = MavlinkOptions()


def mavlink(mission: MissionName, /, *, options: MavlinkOptions = _DEFAULTS) -> Exit:
    """Create MAVLink signing keys for a mission's vehicles, and set them up on the connected vehicles.

    A key for each vehicle is written to the mission's link.signing_key_file; existing keys are kept. The key is sent
    to the vehicle unencrypted: connect by USB, or over a private link.

    Example: cordon keys issue mavlink first.toml --vehicle 3
    """
    from gcs.console.terminal import print_line, print_problem
    from gcs.link.signing_keys import issue_keys, signing_key_path
    from gcs.link.signing_setup import leaves_this_computer, set_up_signing

    flown = loaded_mission(mission)
    path = signing_key_path(flown)
    if path is None:
        raise InputError(
            ['link.signing_key_file: the mission has none; next: [link] signing_key_file = "mavlink.keys"']
        )
    chosen = options.vehicle
    vehicles = flown.vehicles if chosen is None else (chosen_vehicle(flown, chosen, "--vehicle"),)
    for vehicle in vehicles:
        if leaves_this_computer(vehicle.section.url):
            print_line(f"vehicle {vehicle.id}: others may read its key on {vehicle.section.url}; prefer USB", "yellow")
    keys = issue_keys(path, [vehicle.system_id for vehicle in vehicles])
    print_line(
        f"{path}: keys of system id {', '.join(map(str, sorted(keys)))}; keep it secret: it can command the vehicles"
    )
    results = asyncio.run(set_up_signing(vehicles, keys))
    for each in results:
        if each.signs:
            print_line(f"vehicle {each.vehicle_id}: {each.found}")
        else:
            print_problem(f"vehicle {each.vehicle_id}: {each.found}", each.next_step)
    return Exit.HOLDS if all(each.signs for each in results) else Exit.REFUSED
