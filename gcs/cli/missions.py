"""`cordon missions`: the bundled missions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cyclopts import Parameter

from gcs.cli.options import Json
from gcs.errors import Exit

if TYPE_CHECKING:
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class MissionsOptions:
    """Options of `cordon missions`."""

    json: Json = False


_DEFAULTS = MissionsOptions()
_FORMS: tuple[Callable[[float], str], ...] = (
    "{:g} m".format,
    "{:g} rad/s".format,
    lambda speed_m_s: f"{speed_m_s:g} m/s" if speed_m_s else "at rest",
)
"""Of a ring's radius, its rate and its target's speed."""


def missions(*, options: MissionsOptions = _DEFAULTS) -> Exit:
    """List the bundled missions: vehicles, shape, ring, target, duration and purpose.

    Example: cordon missions
    """
    from gcs.cli.output import print_result
    from gcs.metrics.json_output import json_output
    from gcs.mission.file import bundled_missions, load_mission

    known = [load_mission(name) for name in bundled_missions()]
    print_result(json_output({"missions": list(map(_facts, known))}) if options.json else _table(known))
    return Exit.HOLDS


def _facts(mission: "Mission") -> dict[str, object]:
    """Return a mission's entry in the list, by the keys of the JSON; the ring is the first of several."""
    return {
        "mission": mission.mission.name,
        "vehicles": len(mission.vehicles),
        "shape": mission.agent_config(mission.vehicles[0]).shape,
        **_ring(mission),
        "duration_s": mission.mission.duration_s,
        "description": mission.mission.description,
    }


def _ring(mission: "Mission") -> dict[str, float]:
    """Return the first ring of a mission, and how fast its target is."""
    return {
        "radius_m": mission.encirclement.radius_m,
        "angular_rate_rad_s": mission.encirclement.angular_rate_rad_s,
        "target_speed_m_s": mission.target.speed_max_m_s,
    }


def _table(known: "list[Mission]") -> str:
    """Return a line for each mission, its columns aligned."""
    rows = [("mission", "vehicles", "shape", "radius", "rate", "target", "duration", "what happens")]
    for mission in known:
        facts = _facts(mission)
        rings = list(zip(*(_ring(each).values() for each in mission.alone), strict=True))
        radius, rate, target = (
            ", ".join(dict.fromkeys(map(form, values))) for form, values in zip(_FORMS, rings, strict=True)
        )
        row = f"{facts['mission']}", f"{facts['vehicles']}", f"{facts['shape']}", radius, rate, target
        rows.append((*row, f"{facts['duration_s']:g} s", f"{facts['description']}"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    return "\n".join(lines)
