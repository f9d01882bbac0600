"""Reads a file of areas, whatever its name: a plan of QGroundControl, KML or GeoJSON."""

from pathlib import Path

from estimation.input_file import read_plain
from gcs.errors import InputError, KeyFault
from gcs.zones.drawing import DrawnField
from gcs.zones.geojson import KINDS, geojson_drawing
from gcs.zones.json_node import json_root
from gcs.zones.kml import kml_drawing
from gcs.zones.plan_file import FILE_TYPE, plan_drawing

BYTES_MAX = 8_000_000
_KNOWN = "a QGroundControl .plan, KML or GeoJSON is read"
_JSON = {".plan": "a QGroundControl plan", ".geojson": "GeoJSON"}


def read_drawing(path: Path) -> DrawnField:
    """Return what a file holds, at least one area or point; raises InputError that names file, place and value."""
    file = path.name
    try:
        content = read_plain(path, BYTES_MAX)
    except OSError as error:
        raise InputError([KeyFault(str(path), f"{error.strerror or error}")]) from error
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()[:4]
    if not start:
        raise InputError([KeyFault(str(path), f"it is empty; {_KNOWN}")])
    if start.startswith(b"PK\x03\x04"):
        raise InputError([KeyFault(str(path), "it is packed, perhaps a KMZ; next: unzip it, and give the .kml in it")])
    try:
        drawing = _parsed(file, start, content)
    except RecursionError as error:
        raise InputError([KeyFault(file, "it is nested too deeply")]) from error
    if not (drawing.areas or drawing.points):
        raise InputError([KeyFault(file, f"the {drawing.file_format} holds no area and no rally point")])
    return drawing


def _parsed(file: str, start: bytes, content: bytes) -> DrawnField:
    if start.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):
        return kml_drawing(file, content)
    try:
        root = json_root(file, content)
    except InputError as error:
        if Path(file).suffix.lower() == ".kml":
            raise InputError([KeyFault(file, "it is not KML: it does not begin with '<'")]) from error
        if named := _JSON.get(Path(file).suffix.lower()):
            raise InputError(
                [each._replace(reason=f"it is not {named}: {each.reason}") for each in error.placed]
            ) from error
        raise
    if not isinstance(root.value, dict):
        raise root.fault(f"its content is no object; {_KNOWN}")
    if "fileType" in root.value or "geoFence" in root.value:
        if root.value.get("fileType") != FILE_TYPE:
            raise root.fault(f"its fileType is not {FILE_TYPE!r} (given: {str(root.value.get('fileType'))[:20]!r})")
        return plan_drawing(root)
    if root.value.get("type") in KINDS:
        return geojson_drawing(root)
    raise root.fault(f"it has neither a fileType nor a type of GeoJSON; {_KNOWN}")
