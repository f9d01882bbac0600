"""Pages as one HTML file without network access, for screen and print: templates and the legend of lines."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from gcs.metrics.record import FlightRecord
from gcs.style import DARK, themed, vehicle_style


@dataclass(frozen=True, slots=True)
class KeyLine:
    """The style of one line in the legend of a page."""

    label: str
    colour: str
    dashes: str


def render(template: str, **context: object) -> str:
    """Return a page rendered from a template of this package; text is escaped unless it is markup."""
    environment = Environment(
        loader=PackageLoader("gcs.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["themed"] = themed
    return environment.get_template(template).render(dark=DARK, **context)


def key_of(record: FlightRecord) -> tuple[KeyLine, ...]:
    """Return the legend: the line style of every vehicle."""
    vehicles = len(record.vehicles)
    return tuple(
        key_line(f"vehicle {track.vehicle_id}", vehicle_style(row, vehicles))
        for row, track in enumerate(record.vehicles)
    )


def key_line(label: str, style: Mapping[str, Any]) -> KeyLine:
    """Return a line of a legend in a style of matplotlib's."""
    dashes = "" if style["linestyle"] == "-" else " ".join(f"{2.0 * part:g}" for part in style["linestyle"][1])
    return KeyLine(label, style["color"], dashes)
