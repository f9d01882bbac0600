"""`cordon tiles`: map tiles of an area in one file, for fields without a network."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import RESULT, Json, loaded_mission, only_file
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from gcs.station.tile_area import TileArea
    from gcs.station.tile_store import ReadTile
    from gcs.station.tiles import TileImage

TILE_BYTES = 20_000
"""The size that a tile is assumed to have, before any is read."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TilesOptions:
    """Options of `cordon tiles`, without the area."""

    source: Annotated[
        str,
        Parameter(
            name="--from",
            help="Where tiles come from: an .mbtiles file, a folder Z/X/Y, or a server's address with {z}, {x} and {y} "
            "in it, whose licence has to allow the download.",
        ),
    ]
    out: Annotated[
        Path,
        Parameter(
            validator=only_file,
            group=RESULT,
            help="The .mbtiles file to write. The same command again continues it after a break.",
        ),
    ]
    zoom: Annotated[
        str, Parameter(help="Lowest and highest level, MIN:MAX; a pixel of level 18 is 0.6 m wide or less.")
    ] = "14:18"
    rate: Annotated[
        float,
        Parameter(help="Largest number of requests to a server per second.", validator=Number(gte=0.1, lte=20.0)),
    ] = 4.0
    attribution: Annotated[str, Parameter(help="Whose tiles they are, as the map then shows.")] = ""
    yes: Annotated[
        bool, Parameter(negative="", help="The server's licence allows the download; do not ask on the terminal.")
    ] = False
    json: Json = False


def tiles(
    area: Annotated[str, Parameter(help="A mission, or SOUTH,WEST,NORTH,EAST in degrees.", allow_leading_hyphen=True)],
    /,
    *,
    options: TilesOptions,
) -> Exit:
    """Write the map tiles of an area to an .mbtiles file, for the operator's page in fields without a network.

    Exit code 1 if a server ends the download - the same command continues it - or nothing is found.

    Example: cordon tiles my.toml --from orthophoto.mbtiles --zoom 15:20 --out my.mbtiles
    """
    from gcs.cli.output import TilesProgress, check_file, confirmed, print_result
    from gcs.console.terminal import print_line, print_problem
    from gcs.metrics.json_output import json_output
    from gcs.station.tile_store import TileStore, fill

    found = _found(area, options.zoom)
    check_file("--out", options.out, (".mbtiles",))
    read, attribution, asks = _source(found, options)
    print_line(f"{found.count} tiles, about {found.count * TILE_BYTES / 1e6:.1f} MB{asks and f', {asks}'}")
    if asks and not options.yes and not confirmed(f"Does the licence of {options.source} allow this download?"):
        print_problem("not confirmed: nothing was downloaded")
        return Exit.REFUSED
    with TileStore(options.out, options.source) as store, TilesProgress(options.out, found.count) as progress:

        def label(image: "TileImage") -> None:
            store.describe(found, image, options.out.stem, attribution)

        filled = fill(store, found, read, label, progress.update)
    print_line(f"{options.out}: {filled.stored} of {found.count} tiles; {filled.missing} are not in {options.source}")
    if filled.problem:
        print_problem(filled.problem, "the same command again continues")
    if options.json:
        facts = {"out": str(options.out), "source": options.source, "tiles": found.count, "stored": filled.stored}
        bounds = {"bounds_deg": [found.south_deg, found.west_deg, found.north_deg, found.east_deg]}
        levels = {"level_min": found.level_min, "level_max": found.level_max}
        print_result(json_output({**facts, "missing": filled.missing, **bounds, **levels, "problem": filled.problem}))
    return Exit.VERDICT_FAILED if filled.problem or not filled.stored else Exit.HOLDS


def _found(area: str, zoom: str) -> "TileArea":
    """Return the area of a mission or of a box; raises InputError."""
    from gcs.station.tile_area import box_area, levels_of, mission_area

    levels = levels_of(zoom)
    return box_area(area, levels) if "," in area else mission_area(loaded_mission(area), levels)


def _source(area: "TileArea", options: TilesOptions) -> "tuple[ReadTile, str, str]":
    """Return what reads a tile, whose tiles they are, and of a server what the download takes; raises InputError."""
    from gcs.station.tile_server import TileServer
    from gcs.station.tiles import opened_tiles

    if "://" in options.source:
        server = TileServer(options.source, options.rate)
        return server.tile, options.attribution, f"{area.count / options.rate / 60.0:.1f} minutes from {server.host}"
    path = Path(options.source)
    if options.out.exists() and path.exists() and path.samefile(options.out):
        raise InputError([f"--out: {options.out} is the file that tiles come from; name another"])
    tiles = opened_tiles(path, area.centre_deg)
    return lambda place: tiles.tile(*place), options.attribution or tiles.picture.source, ""
