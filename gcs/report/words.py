"""A flight told in words: the verdicts with what they rest on, and a paragraph that sums the flight up."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence

from gcs.metrics.result import FlightResult
from gcs.report.evidence.asked import Asked
from gcs.report.view import Verdict

_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
# More vehicles than these are not named one by one.
_NAMED = 4
_SOURCES = {
    "simulation": "in a simulation",
    "sitl": "with simulated autopilots",
    "flight": "in a flight",
}


def verdicts(result: FlightResult, asked: Asked) -> tuple[Verdict, ...]:
    """Return the verdicts in the paper's order, each with what was measured beside what is allowed."""
    holds, allowed, ring = result.verdicts, asked.tolerances, result.ring
    rates = [
        None if v.angular_rate_mean_rad_s is None else v.angular_rate_mean_rad_s - asked.ring.angular_rate_rad_s
        for v in result.vehicles
    ]
    worst = {name: _worst(getattr(v, name) for v in result.vehicles) for name in _JUDGED}
    speed, place = worst["formation_speed_error_rms_m_s"], worst["formation_spacing_error_rms_m"]
    rows = (
        ("C1", "radius", holds.c1, [("", worst["radius_error_rms_m"], allowed.radius_error_rms_m, ".3f", " m", "rms")]),
        (
            "C2",
            "angular velocity",
            holds.c2,
            [("", _worst(rates), allowed.angular_rate_error_rad_s, ".4f", " rad/s", "off")],
        ),
        (
            "C3",
            "spacing",
            holds.c3,
            [("", ring.spacing_error_rms_deg, allowed.spacing_error_rms_deg, ".2f", "°", "rms")],
        ),
        (
            "formation",
            "speed and places",
            holds.formation,
            [
                ("speed ", speed, allowed.formation_speed_error_rms_m_s, ".3f", " m/s", "rms"),
                ("places ", place, allowed.formation_spacing_error_rms_m, ".3f", " m", "rms"),
            ],
        ),
    )
    told = [Verdict(name, meaning, held, _evidence(measured)) for name, meaning, held, measured in rows]
    closest = result.closest_approach_m
    apart = () if closest is None else ((f"{closest:.3f} m", f"at least {allowed.separation_m:g} m"),)
    return (*told, Verdict("separation", "closest approach", holds.separation, apart))


_JUDGED = ("radius_error_rms_m", "formation_speed_error_rms_m_s", "formation_spacing_error_rms_m")


def _evidence(measured: Sequence[tuple[str, float | None, float, str, str, str]]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (f"{what}{value:{form}}{unit} {kind}", f"at most {tolerance:g}{unit}")
        for what, value, tolerance, form, unit, kind in measured
        if value is not None
    )


def headline(result: FlightResult) -> str:
    """Return the verdicts in one line."""
    held = list(result.verdicts.named().values())
    applied, failed = len(held) - held.count(None), held.count(False)
    if not applied:
        return "No verdict applies"
    if failed:
        return f"{_count(failed).capitalize()} of {_count(applied)} verdicts {_does(failed)} not hold"
    return "All verdicts hold" if applied == len(held) else f"All {_count(applied)} verdicts that apply hold"


def summary(result: FlightResult, asked: Asked) -> str:
    """Return the flight in a paragraph."""
    sentences = [_flown(result), *_engaged(result), *_ring(result, asked), *_apart(result, asked), *_guarded(result)]
    told = " ".join([*sentences, *_troubles(result), f"{headline(result)}."])
    return re.sub(r"(\d) (s|m|setpoints?)\b", "\\1\u00a0\\2", told)


def _flown(result: FlightResult) -> str:
    count = len(result.vehicles)
    where = _SOURCES.get(result.source, f"({result.source})")
    known = "" if result.reference == "truth" else "; what is said of positions rests on the vehicles' own estimates"
    who = f"{_count(count).capitalize()} vehicle{_s(count)}"
    return f"{who} flew {result.mission} for {result.duration_s:g} s {where}{known}."


def _engaged(result: FlightResult) -> list[str]:
    joined = sorted((v.engaged_at_s, v.id) for v in result.vehicles if v.engaged_at_s is not None)
    if not joined:
        return ["Nobody left the formation for the target."]
    each = [f"vehicle {vehicle_id} after {at_s:.1f} s" for at_s, vehicle_id in joined]
    told = _listed(each) if len(each) <= _NAMED else f"{_count(len(each))}, from {each[0]} to {each[-1]}"
    stayed = [str(v.id) for v in result.vehicles if v.engaged_at_s is None]
    rest = f"; {_listed(stayed)} did not" if stayed else ""
    return [f"The ring about the target was joined by {told}{rest}."]


def _ring(result: FlightResult, asked: Asked) -> list[str]:
    if result.window_s is None:
        return []
    settled = result.ring.settling_time_s
    radius_m = _worst(v.radius_error_rms_m for v in result.vehicles)
    largest_m = _worst(v.radius_error_max_m for v in result.vehicles)
    parts = []
    if radius_m is not None and largest_m is not None:
        parts.append(
            f"radii stayed within {radius_m:.3f} m rms ({largest_m:.2f} m at most) of {asked.ring.radius_m:g} m"
        )
    if result.ring.spacing_error_rms_deg is not None:
        parts.append(f"the spacings within {result.ring.spacing_error_rms_deg:.2f}° rms of even ones")
    if settled is None:
        start = "It never settled; in the last quarter of the flight"
    else:
        start = f"It settled {settled:.1f} s after the last had joined; from then on"
    return [f"{start} {' and '.join(parts)}."] if parts else []


def _apart(result: FlightResult, asked: Asked) -> list[str]:
    if result.closest_approach_m is None:
        return []
    return [
        f"No two vehicles came closer than {result.closest_approach_m:.2f} m to each other; "
        f"{asked.tolerances.separation_m:g} m were asked for."
    ]


def _guarded(result: FlightResult) -> list[str]:
    if result.guard_interventions is None:
        return []
    if not result.guard_interventions:
        return ["The guard had nothing to change."]
    counted = [f"{cause} {count}" for cause, count in result.guard_causes.items()]
    why = f" ({_listed(counted)})" if counted else ""
    return [f"The guard changed {result.guard_interventions} setpoint{_s(result.guard_interventions)}{why}."]


def _troubles(result: FlightResult) -> list[str]:
    kinds = Counter(event.kind for event in result.events)
    told = []
    if kinds["failsafe"]:
        told.append(f"Failsafes spoke {_times(kinds['failsafe'])}; the time line says of what.")
    if kinds["command"]:
        told.append(f"An operator's commands were noted {_times(kinds['command'])}.")
    return told


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{_count(count)} times")


def _count(count: int) -> str:
    return _COUNTS[count] if count < len(_COUNTS) else str(count)


def _does(count: int) -> str:
    return "does" if count == 1 else "do"


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _worst(values: Iterable[float | None]) -> float | None:
    return max((abs(value) for value in values if value is not None), default=None)
