"""The parts of the documentation that are generated from the code; `python -m tests.support.docs` writes them."""

import ast
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from inspect import getsource

from agents.safety.failsafe import BY_ITSELF, RESUME, TABLE, Reaction, Row
from estimation.settings import OwnFilterSettings, Settings, TargetFilterSettings
from gcs.console.advice import Severity, advice, severity
from gcs.errors import Exit
from gcs.metrics.catalogue import FLOCKING, VEHICLE, Metric
from gcs.mission.file import bundled_missions, load_mission
from gcs.mission.sections import TUNED, TUNING
from gcs.sweep.columns import RUN, TEAM, Column
from tests.structure import PACKAGES
from tests.support.command_tables import command_list, command_sections, common_arguments
from tests.support.diagrams import life_diagram, tactic_diagram
from tests.support.equations import equation_table
from tests.support.key_tables import identified_keys, mission_keys, profile_keys, tuning_keys
from tests.support.log_fields import field_tables
from tests.support.paths import DOCS, ROOT
from tests.support.public_names import name_sections
from tests.support.result_keys import OUTPUT_KEYS, RESULT_KEYS, RING_KEYS
from tests.support.units import unit

_MODELS: dict[str, type[Settings]] = {
    "own_filter": OwnFilterSettings,
    "target": TargetFilterSettings,
    **{name: model for name, (_, model) in TUNED.items()},
}
"""The models of settings by the first word of their names in the failsafe table."""


def mission_table() -> str:
    """Return the bundled missions with their descriptions, as Markdown."""
    rows = [f"| `{name}` | {load_mission(name).mission.description} |" for name in bundled_missions()]
    return "\n".join(["| mission | what happens |", "|---|---|", *rows])


def folder_table() -> str:
    """Return the folders of the packages, from the top, with what each holds, as Markdown."""
    rows = ["| folder | holds |", "|---|---|"]
    for package in PACKAGES:
        rows += [_folder(f"{package}/{name}") for name in ("", *_floors(package))]
    return "\n".join(rows)


def _mermaid(diagram: Callable[[], str]) -> Callable[[], str]:
    """Return a diagram as a Mermaid block."""
    return lambda: f"```mermaid\n{diagram()}\n```"


def failsafe_table() -> str:
    """Return the failsafe table as Markdown, its grace times with their defaults."""
    head = ["| condition | grace | reaction | on the way down | left |", "|---|---|---|---|---|"]
    return "\n".join(head + [_failsafe(row) for row in TABLE])


def alarm_table() -> str:
    """Return the conditions for which a vehicle leaves its mission, with what the operator does, as Markdown."""
    return _advice_table("alarm")


def warning_table() -> str:
    """Return the conditions under which a vehicle flies on, with what the operator does, as Markdown."""
    return _advice_table("warning")


def sweep_columns() -> str:
    """Return the columns of a sweep's table as Markdown; those that differ in the phase or the extreme are one item."""
    names = {each.name for each in TEAM}
    phases = [replace(each, name=f"reynolds.PHASE.{each.name}") for each in FLOCKING]
    team = [each for each in TEAM if not each.name.startswith(("reynolds.", "vehicles."))]
    over = {
        each.name: [name for end in ("mean", "worst") if (name := f"vehicles.{each.name}.{end}") in names]
        for each in VEHICLE
    }
    single = [replace(each, name=", ".join([f"vehicle_ID.{each.name}", *over[each.name]])) for each in VEHICLE]
    rows: tuple[Column | Metric, ...] = (*RUN, *team, *phases, *single)
    return "\n".join(map(_sweep_column, rows))


def result_keys() -> str:
    """Return the JSON keys of a flight's result, each part in a line, as Markdown."""
    return _key_list({part or "result": keys for part, keys in {**RESULT_KEYS, **RING_KEYS}.items()})


def output_keys() -> str:
    """Return the JSON keys of the other outputs as Markdown."""
    return _key_list(OUTPUT_KEYS)


def exit_codes() -> str:
    """Return the exit codes as Markdown."""
    tree = ast.parse(getsource(Exit)).body[0]
    assert isinstance(tree, ast.ClassDef)
    texts = [ast.literal_eval(each.value) for each in tree.body if isinstance(each, ast.Expr)][1:]
    rows = [f"| {code.value} | {' '.join(text.split())} |" for code, text in zip(Exit, texts, strict=True)]
    return "\n".join(["| code | means |", "|---|---|", *rows])


GENERATED: dict[str, dict[str, Callable[[], str]]] = {
    "commands.md": {"list": command_list, "common": common_arguments, "commands": command_sections},
    "design.md": {"folders": folder_table, "tactics": _mermaid(tactic_diagram)},
    "json.md": {"result": result_keys, "outputs": output_keys, "exits": exit_codes},
    "log-fields.md": {"fields": field_tables},
    "mission-keys.md": {"keys": mission_keys, "profile": profile_keys},
    "missions.md": {"missions": mission_table},
    "notes/design.md": {"life": _mermaid(life_diagram)},
    "notes/paper.md": {"equations": equation_table},
    "notes/identification.md": {"identified": identified_keys},
    "notes/tuning.md": {"tuning": tuning_keys},
    "operator.md": {"alarms": alarm_table, "warnings": warning_table},
    "python-names.md": {"names": name_sections},
    "safety.md": {"failsafes": failsafe_table},
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
    return (name for name in names if (ROOT / package / name / "__init__.py").exists())


def _folder(path: str) -> str:
    text = ast.get_docstring(ast.parse((ROOT / path / "__init__.py").read_text(encoding="utf-8"))) or ""
    return f"| `{path.rstrip('/')}` | {' '.join(text.partition(chr(10) * 2)[0].split())} |"


def _failsafe(row: Row) -> str:
    cells = (
        f"**{row.condition.value}**",
        _grace(row),
        _reactions(row),
        _descending(row),
        "; ".join(filter(None, ["`auto`" * row.resumes, "" if row.left in (RESUME, BY_ITSELF) else row.left])),
    )
    return f"| {' | '.join(cells)} |"


def _advice_table(grade: Severity) -> str:
    """Return the conditions of a severity; how vehicles react to a warning is the same for all, and left out."""
    leaves = grade == "alarm"
    heads = ["condition", "means", *(["the vehicle"] if leaves else []), "you"]
    rows = []
    for row in TABLE:
        name = row.condition.value
        reactions = "; then ".join(each.value for each in row.reactions)
        if severity(name) == grade:
            cells = [f"**{name}**", _with_defaults(row.detected), *([reactions] if leaves else []), advice(name)]
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *rows])


def _with_defaults(text: str) -> str:
    """Return a text with the default and its unit in place of each setting that is a number."""

    def value(setting: re.Match[str]) -> str:
        default, symbol = _MODELS[setting[1]].model_fields[setting[2]].default, unit(setting[2])
        if not isinstance(default, float):
            return setting[0]
        return f"{default:g}{'' if symbol in ('°', '1/s') else ' '}{symbol.removeprefix('1/s')}".rstrip()

    return re.sub(r"`(?:tuning\.)?(\w+)\.(\w+)`", value, text)


def _key_list(keys: Mapping[str, str]) -> str:
    return "\n".join(f"- {name}: {', '.join(f'`{key}`' for key in each.split())}" for name, each in keys.items())


def _sweep_column(column: Column | Metric) -> str:
    names = ", ".join(f"`{name}`" for name in column.name.split(", "))
    kind = "" if column.kind is float else f" ({column.kind.__name__})"
    return f"- {names}{kind}: {column.meaning}"


def _reactions(row: Row) -> str:
    values = [reaction.value for reaction in row.reactions]
    return f"{' or '.join(values)} (`{row.choice}`)" if row.choice else "; then ".join(values)


def _grace(row: Row) -> str:
    if not row.grace:
        return ""
    name, key = row.grace.split(".")
    section, model = TUNED[name]
    place = f"tuning.{row.grace}" if key in TUNING[name].model_fields else f"{section}.{key}"
    wall = ", wall" if row.by_wall else ""
    return f"{model.model_fields[key].default:g} s{wall} (`{place}`)"


def _descending(row: Row) -> str:
    if row.descending is not None:
        return row.descending.value
    at_once = row.reactions[0] in (Reaction.LAND, Reaction.HAND_OVER)
    return row.reactions[0].value if at_once else ""


if __name__ == "__main__":
    for document in GENERATED:
        (DOCS / document).write_text(renewed(document), encoding="utf-8")
