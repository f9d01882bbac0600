"""The keys of missions and profiles with meanings, units, defaults and values, from the models that read them."""

import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from agents.settings.sections import NoFlySection, RallySection
from estimation.plant.model import Identification
from estimation.profile.profile import AxisSection, LimitsSection, ProfileFile
from estimation.settings import OwnFilterSettings, Settings
from gcs.mission.mission import (
    ChecklistItem,
    EvadesSection,
    LegSection,
    RingKeys,
    SecuritySection,
    SensorChange,
    SensorSection,
    SharedLinkSection,
    VehicleSection,
)
from gcs.mission.sections import SECTIONS, TUNING
from tests.support.units import unit

_MISSION: dict[str, type[Settings]] = {
    **{f"[{name}]": model for name, model in SECTIONS.items()},
    "[[safety.no_fly]]": NoFlySection,
    "[[safety.rally]]": RallySection,
    "[network.security]": SecuritySection,
    "[links.NAME]": SharedLinkSection,
    "[target.sensor]": SensorSection,
    "[[target.legs]]": LegSection,
    "[target.evades]": EvadesSection,
    "[[rings]]": RingKeys,
    "[[vehicles]]": VehicleSection,
    "[[checklist]]": ChecklistItem,
}
_PROFILE: dict[str, type[Settings]] = {
    "Above all sections": ProfileFile,
    "[x], [y]": AxisSection,
    "[own_filter]": OwnFilterSettings,
    "[limits]": LimitsSection,
}
_REPLACES: dict[type[Settings], type[Settings]] = {SensorChange: SensorSection}
"""Models whose keys are those of another one and replace its values: they have no table of their own."""


def mission_keys() -> str:
    """Return every section of a mission file with its keys, as Markdown."""
    assert all(change.model_fields.keys() == model.model_fields.keys() for change, model in _REPLACES.items())
    return "\n\n".join(_table(title, model) for title, model in _MISSION.items())


def profile_keys() -> str:
    """Return every section of a profile with its keys, as Markdown."""
    return "\n\n".join(_table(title, model) for title, model in _PROFILE.items())


def identified_keys() -> str:
    """Return the section of a profile that `cordon identify` writes, as Markdown."""
    return _table("[identified]", Identification)


def tuning_keys() -> str:
    """Return every table of `[tuning]`, and a profile's filter, with the reasons for the defaults, as Markdown."""
    tables: dict[str, type[Settings]] = {f"[tuning.{name}]": model for name, model in TUNING.items()}
    tables["[own_filter]"] = OwnFilterSettings
    return "\n\n".join(_table(title, model, reasons=True) for title, model in tables.items())


def _table(title: str, model: type[Settings], *, reasons: bool = False) -> str:
    """Return a section's heading, purpose and keys; columns that no key fills are left out."""
    own = [name for name in model.model_fields if name in model.__annotations__]
    names = [*own, *(name for name in model.model_fields if name not in own)]  # inherited keys last
    fields = {name: model.model_fields[name] for name in names}
    columns = {
        "key": [f"`{name}`" for name in fields],
        "meaning": [_meaning(name, field) for name, field in fields.items()],
        "symbol": [_extra(field, "symbol") for field in fields.values()],
        "default": [_default(field) for field in fields.values()],
        "values": [_values(field) for field in fields.values()],
        "reason for the default": [_extra(field, "reason") if reasons else "" for field in fields.values()],
    }
    filled = {head: cells for head, cells in columns.items() if any(cells)}
    rows = [f"| {' | '.join(row)} |" for row in (filled, *zip(*filled.values(), strict=True))]
    return "\n".join([*_head(title, model), rows[0], "|---" * len(filled) + "|", *rows[1:]])


def _head(title: str, model: type[Settings]) -> list[str]:
    purpose = " ".join((model.__doc__ or "").split()).replace("|", "\\|").removeprefix(f"`{title}`: ")
    purpose = re.sub(r"docs/([a-z-]+\.md)", r"[\1](\1)", purpose)
    heading = title if title[0].isupper() else f"`{title}`"
    return [f"### {heading}", "", purpose[:1].upper() + purpose[1:], ""]


def _meaning(name: str, field: FieldInfo) -> str:
    """Return the meaning of a key, with its unit in brackets."""
    symbol = unit(name)
    meaning = (field.description or "").replace("|", "\\|")
    assert meaning, f"{name} has no description"
    return f"{meaning} [{symbol}]" if symbol else meaning


def _extra(field: FieldInfo, key: str) -> str:
    extra = field.json_schema_extra
    return str(extra[key]) if isinstance(extra, dict) else ""


def _default(field: FieldInfo) -> str:
    if field.default_factory is not None:
        return f"`{field.get_default(call_default_factory=True, validated_data={'id': 1})}` for id 1"
    if field.default is PydanticUndefined:
        return "required"
    if isinstance(field.default, Settings):
        return "see below" if isinstance(field.default, OwnFilterSettings | LimitsSection) else ""
    return _toml(field.default) if field.default is not None else ""


def _toml(value: object) -> str:
    """Return a value as a mission file holds it."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return f"`{text.replace('(', '[').replace(')', ']') if isinstance(value, tuple) else text}`"


def _values(field: FieldInfo) -> str:
    """Return the values that a key may have: its names, or an interval."""
    kinds = list(_kinds(field.annotation))
    names = [name for kind in kinds if get_origin(kind) is Literal for name in get_args(kind)]
    if names:
        return ", ".join(f"`{name}`" for name in names)
    limits = {
        name: value
        for limit in field.metadata
        for name in ("gt", "ge", "lt", "le")
        if (value := getattr(limit, name, None)) is not None
    }
    low = next((f"{sign}{limits[name]:g}" for name, sign in (("gt", "("), ("ge", "[")) if name in limits), "(-∞")
    high = next((f"{limits[name]:g}{sign}" for name, sign in (("lt", ")"), ("le", "]")) if name in limits), "∞)")
    return f"{low},{high}" if limits else ""


def _kinds(annotation: Any) -> Iterator[Any]:
    """Yield the types that an annotation is made of, a literal as one."""
    if get_origin(annotation) is Literal or not get_args(annotation):
        yield annotation
    else:
        for each in get_args(annotation):
            yield from _kinds(each)
