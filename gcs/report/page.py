"""Pages as one HTML file without network access, for screen and print: templates and the legend of lines."""

from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from gcs.metrics.record import FlightRecord
from gcs.style import vehicle_style


@dataclass(frozen=True, slots=True)
class KeyLine:
    """The line style of one vehicle in the legend of a page."""

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
    return environment.get_template(template).render(**context)


def key_of(record: FlightRecord) -> tuple[KeyLine, ...]:
    """Return the legend: the line style of every vehicle."""
    lines = []
    for row, track in enumerate(record.vehicles):
        style = vehicle_style(row, len(record.vehicles))
        dashes = "" if style["linestyle"] == "-" else " ".join(f"{2.0 * part:g}" for part in style["linestyle"][1])
        lines.append(KeyLine(f"vehicle {track.vehicle_id}", style["color"], dashes))
    return tuple(lines)
