"""The parts of the documentation that are generated from the code; `python -m tests.support.docs` writes them."""

import ast
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from inspect import getdoc

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from agents.safety.failsafe import TABLE, Reaction, Row
from agents.shell import life
from agents.tactics import diagram
from cordon.channels import VehicleChannels
from estimation.plant.provenance import Identification
from estimation.profile.profile import AxisSection, LimitsSection, ProfileFile
from estimation.settings import OwnFilterSettings, Settings
from gcs.mission.file import bundled_missions, load_mission
from gcs.mission.links import SharedLinkSection
from gcs.mission.mission import LegSection, SecuritySection, SensorChange, SensorSection, TrueScale, VehicleSection
from gcs.mission.sections import SECTIONS, TUNED, TUNING
from gcs.sweep.columns import RUN, TEAM, VEHICLE, Column
from tests.structure import PACKAGES
from tests.support.equations import equation_table
from tests.support.log_fields import field_tables
from tests.support.paths import DOCS, ROOT

_TABLES: dict[str, type[Settings]] = {
    **{f"[{name}]": model for name, model in SECTIONS.items()},
    "[network.security]": SecuritySection,
    "[links.NAME]": SharedLinkSection,
    "[target.sensor]": SensorSection,
    "[[target.legs]]": LegSection,
    "[[vehicles]]": VehicleSection,
    "true_scale of a vehicle": TrueScale,
    "sensor of a vehicle": SensorChange,
}
_PROFILE_TABLES: dict[str, type[Settings]] = {
    "Above all sections": ProfileFile,
    "[x], [y]": AxisSection,
    "[own_filter]": OwnFilterSettings,
    "[limits]": LimitsSection,
    "[identified]": Identification,
}
_LIMITS = (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))


def mission_table() -> str:
    """Return the bundled missions with their descriptions, as Markdown."""
    rows = [f"| `{name}` | {load_mission(name).mission.description} |" for name in bundled_missions()]
    return "\n".join(["| mission | what happens |", "|---|---|", *rows])


def key_tables() -> str:
    """Return every section of a mission file with its keys, defaults and ranges, as Markdown."""
    return "\n\n".join(_table(title, model) for title, model in _TABLES.items())


def profile_tables() -> str:
    """Return every section of a profile with its keys, defaults and ranges, as Markdown."""
    return "\n\n".join(_table(title, model) for title, model in _PROFILE_TABLES.items())


def tuning_tables() -> str:
    """Return every table of `[tuning]` with its keys: symbol, default, range, and the reason for the default."""
    return "\n\n".join(_tuning_table(f"[tuning.{name}]", model) for name, model in TUNING.items())


def folder_table() -> str:
    """Return the folders of the packages, from the top, with what each holds and may import, as Markdown."""
    rows = ["| folder | holds | may import |", "|---|---|---|"]
    for package in PACKAGES:
        rows += [_folder(f"{package}/{name}") for name in ("", *_floors(package))]
    return "\n".join(rows)


def tactic_diagram() -> str:
    """Return the tactic machine as a Mermaid block."""
    return f"```mermaid\n{diagram()}\n```"


def life_diagram() -> str:
    """Return the life of an agent as a Mermaid block."""
    return f"```mermaid\n{life.diagram()}\n```"


def failsafe_table() -> str:
    """Return the failsafe table as Markdown, its grace times with their defaults."""
    head = ["| condition | detected when | grace | reaction | on the way down | left |", "|---|---|---|---|---|---|"]
    return "\n".join(head + [_failsafe(row) for row in TABLE])


def channel_list() -> str:
    """Return the channels of a vehicle's flight, from the docstring of their class."""
    return (getdoc(VehicleChannels) or "").partition("\n\n")[2]


def sweep_columns() -> str:
    """Return the columns of a sweep's table as Markdown."""
    single = [replace(each, name=f"vehicle_ID.{each.name}") for each in VEHICLE]
    head = ["| column | type | holds |", "|---|---|---|"]
    return "\n".join(head + [_sweep_column(each) for each in (*RUN, *TEAM, *single)])


GENERATED: dict[str, dict[str, Callable[[], str]]] = {
    "missions.md": {"missions": mission_table, "keys": key_tables, "profile": profile_tables, "tuning": tuning_tables},
    "python.md": {"channels": channel_list},
    "design.md": {"folders": folder_table, "tactics": tactic_diagram, "life": life_diagram},
    "safety.md": {"failsafes": failsafe_table},
    "paper.md": {"equations": equation_table},
    "logs.md": {"fields": field_tables},
    "sweeps.md": {"columns": sweep_columns},
}
"""The generated parts of each document: their functions, by the name of their marks."""


def renewed(name: str) -> str:
    """Return a document's text with its generated parts renewed."""
    text = (DOCS / name).read_text(encoding="utf-8")
    for mark, generate in GENERATED[name].items():
        begin, end = f"<!-- {mark} -->", f"<!-- end of {mark} -->"
        before, _, rest = text.partition(begin)
        _, _, after = rest.partition(end)
        text = f"{before}{begin}\n{generate()}\n{end}{after}"
    return text


def _floors(package: str) -> Iterator[str]:
    """Return the folders of a package in the order of its import contract, the highest first."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    layers = (each["layers"] for each in contracts if each.get("containers") == [package])
    names = (name.strip() for floors in layers for floor in floors for name in floor.split("|"))
    return (name for name in names if (ROOT / package / name).is_dir())


def _folder(path: str) -> str:
    text = ast.get_docstring(ast.parse((ROOT / path / "__init__.py").read_text(encoding="utf-8"))) or ""
    holds, _, imports = (" ".join(part.split()) for part in text.partition("\n\n"))
    return f"| `{path.rstrip('/')}` | {holds} | {imports} |"


def _failsafe(row: Row) -> str:
    cells = (
        f"**{row.condition.value}**",
        row.detected,
        _grace(row),
        _reactions(row),
        _descending(row),
        row.left,
    )
    return f"| {' | '.join(cells)} |"


def _sweep_column(column: Column) -> str:
    return f"| `{column.name}` | {column.kind.__name__} | {column.meaning} |"


def _reactions(row: Row) -> str:
    values = [reaction.value for reaction in row.reactions]
    return f"{' or '.join(values)} (`{row.choice}`)" if row.choice else "; then ".join(values)


def _grace(row: Row) -> str:
    if not row.grace:
        return "none"
    name, key = row.grace.split(".")
    section, model = TUNED[name]
    place = f"tuning.{row.grace}" if key in TUNING[name].model_fields else f"{section}.{key}"
    wall = ", wall" if row.by_wall else ""
    return f"{model.model_fields[key].default:g} s{wall} (`{place}`)"


def _descending(row: Row) -> str:
    if row.descending is not None:
        return row.descending.value
    at_once = row.reactions[0] in (Reaction.LAND, Reaction.HAND_OVER)
    return row.reactions[0].value if at_once else "goes on"


def _table(title: str, model: type[Settings]) -> str:
    own = [name for name in model.model_fields if name in model.__annotations__]
    names = [*own, *(name for name in model.model_fields if name not in own)]  # inherited keys last
    fields = ((name, model.model_fields[name]) for name in names)
    if any(field.description for field in model.model_fields.values()):
        return _tuning_table(title, model)
    rows = [f"| `{name}` | {_default(field)} | {_range(field)} |" for name, field in fields]
    return "\n".join([*_head(title, model), "| key | default | range |", "|---|---|---|", *rows])


def _tuning_table(title: str, model: type[Settings]) -> str:
    fields = model.model_fields
    symbols = any(map(_symbol, fields.values()))
    rows = []
    for name, field in fields.items():
        cells = [f"`{name}`", *([_symbol(field)] if symbols else []), _default(field), _range(field), field.description]
        rows.append(f"| {' | '.join(map(str, cells))} |")
    head = ["key", *(["symbol"] if symbols else []), "default", "range", "reason for the default"]
    return "\n".join([*_head(title, model), f"| {' | '.join(head)} |", "|---" * len(head) + "|", *rows])


def _head(title: str, model: type[Settings]) -> list[str]:
    purpose = " ".join((model.__doc__ or "").split()).replace("|", "\\|").removeprefix(f"`{title}`: ")
    heading = title if title[0].isupper() else f"`{title}`"
    return [f"### {heading}", "", purpose[:1].upper() + purpose[1:], ""]


def _symbol(field: FieldInfo) -> str:
    extra = field.json_schema_extra
    return str(extra["symbol"]) if isinstance(extra, dict) else ""


def _default(field: FieldInfo) -> str:
    if field.default_factory is not None:
        return f"`{field.get_default(call_default_factory=True, validated_data={'id': 1})}` for id 1, and so on"
    if field.default is PydanticUndefined:
        return "required"
    if isinstance(field.default, Settings):
        return "see below"
    return f"`{field.default!r}`" if field.default is not None else "none"


def _range(field: FieldInfo) -> str:
    limits = [
        f"{sign} {getattr(limit, name):g}"
        for limit in field.metadata
        for name, sign in _LIMITS
        if getattr(limit, name, None) is not None
    ]
    return ", ".join(limits)


if __name__ == "__main__":
    for document in GENERATED:
        (DOCS / document).write_text(renewed(document), encoding="utf-8")
