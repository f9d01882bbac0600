"""`cordon zones`: fences, no-fly zones and rally points from files of other programs."""

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from gcs.cli.options import RESULT, Json, MissionName, chosen_vehicle, loaded_mission, only_file
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimation.frames import MissionFrame
    from gcs.mission.mission import Mission
    from gcs.zones.drawing import DrawnField
    from gcs.zones.layout import GroundArea, Layout

zones = App(
    name="zones",
    help="Take fences, no-fly zones and rally points from other programs, and give them to these.\n\n"
    "Example: cordon zones import field.plan --mission my.toml",
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """Options of `cordon zones import`, without the file."""

    mission: Annotated[
        str | None,
        Parameter(help="The mission they are for: areas are printed in its frame, as the tables of its file."),
    ] = None
    fence: Annotated[
        str | None, Parameter(help="Name of the area to stay in, if the file does not say so, or has several.")
    ] = None
    out: Annotated[
        Path | None,
        Parameter(
            validator=only_file,
            group=RESULT,
            help="Write the mission with them to this .toml file, which must not exist yet; its comments stay.",
        ),
    ] = None
    json: Json = False


_DEFAULTS = ImportOptions()


@zones.command(name="import")
def import_zones(
    file: Annotated[Path, Parameter(validator=only_file, help="A QGroundControl .plan, a KML or a GeoJSON file.")],
    /,
    *,
    options: ImportOptions = _DEFAULTS,
) -> Exit:
    """Read fence, no-fly zones and rally points from a file, and print them as tables of a mission.

    Example: cordon zones import field.plan --mission my.toml --out my-field.toml
    """
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line
    from gcs.metrics.json_output import json_output
    from gcs.zones.layout import laid_out, own_frame
    from gcs.zones.reading import read_drawing
    from gcs.zones.tables import tables_text

    if options.out is not None:
        if options.mission is None:
            raise InputError(["--out: it needs --mission, which the zones are written into"])
        _check_new(options.out, ".toml")
    drawing = read_drawing(file)
    if options.mission is None:
        layout = laid_out(drawing, own_frame(drawing), options.fence)
    else:
        mission = loaded_mission(options.mission)
        drawn = laid_out(drawing, _frame(mission, options.mission), options.fence)
        layout = drawn.beside(mission.safety)
        if options.out is not None:
            with _explained(drawn, mission):
                _write(options.mission, options.out, layout)
    for line in _summary(file, drawing, layout):
        print_line(line)
    if options.json:
        print_result(json_output({"file": str(file), "file_format": drawing.file_format, **_facts(options, layout)}))
    elif options.out is not None:
        print_line(f"written: {options.out}; next: cordon check {options.out}")
    elif options.mission is not None:
        print_result(tables_text(layout))
    else:
        print_line("next: give --mission for the tables of a mission in its frame")
    return Exit.HOLDS


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PlanOptions:
    """Options of `cordon zones export`, without the mission."""

    out: Annotated[
        Path,
        Parameter(validator=only_file, group=RESULT, help="The .plan file to write, which must not exist yet."),
    ]
    vehicle: Annotated[
        int | None,
        Parameter(help="The plan for this vehicle: its own fence, if it has one, and its spots at the rally points."),
    ] = None


@zones.command(name="export")
def export_zones(mission: MissionName, /, *, options: PlanOptions) -> Exit:
    """Write a mission's fence, no-fly zones and rally points as a plan, for QGroundControl to upload to the autopilots.

    Example: cordon zones export my.toml --out my.plan
    """
    from gcs.cli.output import writing
    from gcs.console.terminal import print_line
    from gcs.keys.private_files import create
    from gcs.zones.plan_file import plan_text

    _check_new(options.out, ".plan")
    flown = loaded_mission(mission)
    vehicle = None if options.vehicle is None else chosen_vehicle(flown, options.vehicle, "--vehicle")
    _frame(flown, mission)
    limits = flown.safety if vehicle is None else vehicle.section.limits(flown.safety)
    if not (limits.fence_m or flown.safety.no_fly or (flown.safety.rally and vehicle is not None)):
        step = "; next: --vehicle ID, for its spots at the rally points" if flown.safety.rally else ""
        raise InputError([f"{mission}: it has no fence and no no-fly zones to export{step}"])
    with writing("--out", options.out), create(options.out, "xb") as file:
        file.write(plan_text(flown, vehicle).encode())
    if limited := [zone.name for zone in flown.safety.no_fly if zone.floor_m is not None or zone.ceiling_m is not None]:
        print_line(f"a plan has no heights: {', '.join(limited)} closed from the ground up", "yellow")
    if flown.safety.rally and vehicle is None:
        print_line("without rally points: each vehicle has its own spots there; next: --vehicle ID", "yellow")
    print_line(f"written: {options.out}; next: open it in QGroundControl, and upload it to each vehicle")
    return Exit.HOLDS


def _check_new(path: Path, suffix: str) -> None:
    """Refuse a file that cannot be written or exists, before anything is read; raises InputError."""
    from gcs.cli.output import check_file

    check_file("--out", path, (suffix,))
    if path.exists():
        raise InputError([f"--out: {str(path)!r} exists already, and is not overwritten; name another"])


def _frame(mission: "Mission", name: str) -> "MissionFrame":
    """Return a mission's frame; raises InputError for a local one."""
    frame = mission.mission_frame()
    if frame.is_local:
        raise InputError([f"{name}: its frame is local, without latitude and longitude"])
    return frame


@contextmanager
def _explained(drawn: "Layout", mission: "Mission") -> "Iterator[None]":
    """Add to the faults of a mission with a layout which of its zones may be the fence: that around all starts."""
    from agents.safety.fence import Fence

    try:
        yield
    except InputError as error:
        starts_m = [vehicle.section.start_m for vehicle in mission.vehicles]
        around = [
            zone.name
            for zone in drawn.zones
            if not zone.radius_m and all(map(Fence(zone.corners_m).contains, starts_m))
        ]
        if drawn.fence is not None or not around:
            raise
        hint = f"'{around[0]}' covers all starts; next: if it is the area to stay in, --fence {around[0]}"
        raise InputError([*error.placed, f"--fence: {hint}"]) from error


def _write(mission: str, out: Path, layout: "Layout") -> None:
    """Write a mission with a layout; raises InputError with every fault of the new mission."""
    from gcs.cli.output import writing
    from gcs.keys.private_files import create
    from gcs.mission.file import mission_path, mission_text, parse_mission
    from gcs.zones.tables import with_layout

    text = with_layout(mission_text(mission), layout)
    parse_mission(text, mission_path(mission).parent)
    with writing("--out", out), create(out, "xb") as file:
        file.write(text.encode())


def _summary(file: Path, drawing: "DrawnField", layout: "Layout") -> list[str]:
    """Return what was read, line by line, and what was not."""
    lines = [f"{file}: {drawing.file_format}"]
    if layout.fence is not None:
        lines.append(f"fence '{layout.fence.name}': {_extent(layout.fence)}")
    lines += [f"no-fly zone '{zone.name}': {_extent(zone)}{_heights(zone)}" for zone in layout.zones]
    lines += [f"rally point '{point.name}'" for point in layout.points]
    return [*lines, *(f"not taken: {each}" for each in layout.left_out)]


def _extent(area: "GroundArea") -> str:
    shape = f"circle of {area.radius_m:g} m" if area.radius_m else f"{len(area.corners_m)} corners"
    covered = f"{area.area_m2:.0f} m²" if area.area_m2 < 1e6 else f"{area.area_m2 / 1e6:.2f} km²"
    return f"{shape}, {covered}"


def _heights(zone: "GroundArea") -> str:
    if zone.floor_m is None and zone.ceiling_m is None:
        return ""
    low = "the ground" if zone.floor_m is None else f"{zone.floor_m:g} m"
    return f", from {low} up" if zone.ceiling_m is None else f", from {low} to {zone.ceiling_m:g} m"


def _facts(options: ImportOptions, layout: "Layout") -> dict[str, object]:
    """Return the JSON of a layout; places are in the mission's frame, null without a mission."""
    placed = options.mission is not None
    fence = None if layout.fence is None else _area(layout.fence, placed=placed)
    zones = [
        {**_area(zone, placed=placed), "floor_m": zone.floor_m, "ceiling_m": zone.ceiling_m} for zone in layout.zones
    ]
    rally = [{"name": point.name, "place_m": point.place_m if placed else None} for point in layout.points]
    written = None if options.out is None else str(options.out)
    return {"fence": fence, "no_fly": zones, "rally": rally, "not_taken": list(layout.left_out), "written": written}


def _area(area: "GroundArea", *, placed: bool) -> dict[str, object]:
    return {
        "name": area.name,
        "area_m2": round(area.area_m2, 1),
        "corners_m": area.corners_m if placed and not area.radius_m else None,
        "center_m": area.corners_m[0] if placed and area.radius_m else None,
        "radius_m": area.radius_m or None,
    }
