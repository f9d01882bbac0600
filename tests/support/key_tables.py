"""The keys of missions and profiles with units, defaults, ranges and reasons, from the models that read them."""

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from estimation.plant.provenance import Identification
from estimation.profile.profile import AxisSection, LimitsSection, ProfileFile
from estimation.settings import OwnFilterSettings, Settings
from gcs.mission.links import SharedLinkSection
from gcs.mission.mission import LegSection, SecuritySection, SensorChange, SensorSection, TrueScale, VehicleSection
from gcs.mission.sections import SECTIONS, TUNING
from tests.support.units import unit

_MISSION: dict[str, type[Settings]] = {
    **{f"[{name}]": model for name, model in SECTIONS.items()},
    "[network.security]": SecuritySection,
    "[links.NAME]": SharedLinkSection,
    "[target.sensor]": SensorSection,
    "[[target.legs]]": LegSection,
    "[[vehicles]]": VehicleSection,
    "true_scale of a vehicle": TrueScale,
    "sensor of a vehicle": SensorChange,
}
_PROFILE: dict[str, type[Settings]] = {
    "Above all sections": ProfileFile,
    "[x], [y]": AxisSection,
    "[own_filter]": OwnFilterSettings,
    "[limits]": LimitsSection,
    "[identified]": Identification,
}
_LIMITS = (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))


def mission_keys() -> str:
    """Return every section of a mission file with its keys, as Markdown."""
    return "\n\n".join(_table(title, model) for title, model in _MISSION.items())


def profile_keys() -> str:
    """Return every section of a profile with its keys, as Markdown."""
    return "\n\n".join(_table(title, model) for title, model in _PROFILE.items())


def tuning_keys() -> str:
    """Return every table of `[tuning]` with its keys, as Markdown."""
    return "\n\n".join(_table(f"[tuning.{name}]", model) for name, model in TUNING.items())


def _table(title: str, model: type[Settings]) -> str:
    """Return a section's heading, purpose and keys; columns that no key fills are left out."""
    own = [name for name in model.model_fields if name in model.__annotations__]
    names = [*own, *(name for name in model.model_fields if name not in own)]  # inherited keys last
    fields = {name: model.model_fields[name] for name in names}
    columns = {
        "key": [f"`{name}`" for name in fields],
        "symbol": [_symbol(field) for field in fields.values()],
        "unit": [unit(name) for name in fields],
        "default": [_default(field) for field in fields.values()],
        "range": [_range(field) for field in fields.values()],
        "reason for the default": [field.description or "" for field in fields.values()],
    }
    filled = {head: cells for head, cells in columns.items() if any(cells)}
    rows = [filled, ["---"] * len(filled), *zip(*filled.values(), strict=True)]
    return "\n".join([*_head(title, model), *(f"| {' | '.join(row)} |" for row in rows)])


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
