"""Ablation: fly missions with one part of the control disabled in turn, and print the contribution of each part.

Every switch is a change of the mission file, so that `cordon sim` and `cordon fly` can fly the same; `--write FOLDER`
writes these missions, also of px4-trio, instead of flying them.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from estimation.profile.shelf import ProfileShelf
from gcs.flight.simulated import fly_simulated
from gcs.metrics.metrics import evaluate
from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.mission.file import parse_mission
from gcs.mission.mission import Mission
from tests.experiments.arguments import parser
from tests.support.mission_text import Content, content, parsed, text_of, toml
from tests.support.paths import MISSIONS

SIMULATED, FLOWN = ("case2-field", "shaped-trio"), ("px4-trio",)
_RUN_WILD: Mapping[str, Mapping[str, object]] = {
    "encirclement": {"speed_max_m_s": 20.0, "acceleration_max_m_s2": 20.0},
    "formation": {"speed_max_m_s": 20.0},
    "safety": {"setpoint_lead_max_m": 50.0, "speed_max_m_s": 30.0, "acceleration_max_m_s2": 20.0},
    "own_filter": {"disturbance_max_m_s2": 5.0},
}
Switch = Callable[[Content], Content]


def _without(sections: Mapping[str, Mapping[str, object]]) -> Switch:
    def change(mission: Content) -> Content:
        return mission | {name: mission.get(name, {}) | keys for name, keys in sections.items()}

    return change


def _undelayed(mission: Content) -> Content:
    """Set the profile's delay to 0; the true delay is unchanged."""
    undelayed = [each | {"profile": f"{each['profile']}-undelayed.toml"} for each in mission["vehicles"]]
    return mission | {"vehicles": undelayed}


SWITCHES: dict[str, Switch] = {
    "all of it": lambda mission: mission,
    "no delay prediction": _undelayed,
    "no disturbance estimate": _without({"own_filter": {"disturbance_max_m_s2": 0.0}}),
    "only a steady disturbance": _without({"own_filter": {"disturbance_turns": False}}),
    "no bounds": _without(_RUN_WILD),
    "no neighbours' plans": _without({"formation": {"station": "line"}}),
}


def undelayed_profile(name: str) -> str:
    """Return the text of a bundled profile without its delay."""
    profile = ProfileShelf(MISSIONS).load(name)
    plant, own_filter = profile.plant, profile.own_filter.model_dump()
    axes = {
        key: {"a0_per_s2": axis.a0_per_s2, "a1_per_s": axis.a1_per_s} for key, axis in (("x", plant.x), ("y", plant.y))
    }
    return f"delay_s = 0.0\nx = {toml(axes['x'])}\ny = {toml(axes['y'])}\nown_filter = {toml(own_filter)}\n"


def ablated(mission_name: str, switch: str) -> Mission:
    """Return a bundled mission with one part disabled and the same true vehicles."""
    text = content((MISSIONS / f"{mission_name}.toml").read_text(encoding="utf-8"))
    profiles = {vehicle["profile"] for vehicle in text["vehicles"]}
    texts = {f"{name}-undelayed.toml": undelayed_profile(name) for name in profiles}
    given = texts if switch == "no delay prediction" else None
    changed = parse_mission(text_of(SWITCHES[switch](text)), MISSIONS, given)
    pairs = zip(changed.vehicles, parsed(text).vehicles, strict=True)
    return replace(changed, vehicles=tuple(replace(one, true_plant=other.true_plant) for one, other in pairs))


@dataclass(frozen=True)
class Row:
    """The true errors of one mission with one part disabled, of the worst vehicle."""

    radius_rms_m: float
    rate_error: float
    spacing_rms_deg: float
    formation_m: float
    closest_m: float


def row(mission_name: str, switch: str, seed: int) -> Row:
    """Fly one mission with one part disabled."""
    mission = ablated(mission_name, switch)
    record = fly_simulated(mission, seed, mission.mission.duration_s, lambda _: None)
    result = evaluate(record, ring_reference(mission), formation_reference(mission), verdict_tolerances(mission))
    rates = [vehicle.angular_rate_mean_rad_s for vehicle in result.vehicles]
    wanted = mission.encirclement.angular_rate_rad_s
    return Row(
        _worst(vehicle.radius_error_rms_m for vehicle in result.vehicles),
        _worst(None if rate is None else abs(rate / wanted - 1.0) for rate in rates),
        _worst([result.ring.spacing_error_rms_deg]),
        _worst(vehicle.formation_spacing_error_rms_m for vehicle in result.vehicles),
        np.nan if result.closest_approach_m is None else result.closest_approach_m,
    )


def _worst(figures: Iterable[float | None]) -> float:
    return max((figure for figure in figures if figure is not None), default=np.nan)


def write(folder: Path) -> None:
    """Write every mission with every part disabled, and the profiles that they need."""
    for name, (switch, change) in product((*SIMULATED, *FLOWN), SWITCHES.items()):
        text = content((MISSIONS / f"{name}.toml").read_text(encoding="utf-8"))
        for vehicle in text["vehicles"]:
            profile = folder / f"{vehicle['profile']}-undelayed.toml"
            profile.write_text(undelayed_profile(vehicle["profile"]), encoding="utf-8")
        path = folder / f"{name}-{switch.replace(' ', '-').replace(chr(39), '')}.toml"
        path.write_text(text_of(change(text)) + "\n", encoding="utf-8")
        print(path)


def main(count: int) -> None:
    """Fly each mission with each switch over a number of seeds, and print the means."""
    seeds = range(count)
    print(f"{'mission':12} {'':26} radius rms  rate off  spacing rms  formation rms  closest")
    with ProcessPoolExecutor(initializer=os.nice, initargs=(10,)) as pool:
        for name, switch in product(SIMULATED, SWITCHES):
            rows = list(pool.map(row, *zip(*((name, switch, seed) for seed in seeds), strict=True)))
            table = np.array([astuple(each) for each in rows])
            radius, rate, spacing, formation = table[:, :4].mean(axis=0)
            print(
                f"{name:12} {switch:26} {radius:8.3f} m {rate:9.2%} {spacing:8.2f} deg {formation:12.3f} m "
                f"{table[:, 4].min():6.2f} m",
                flush=True,
            )


if __name__ == "__main__":
    reader = parser("ablation", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=1, help="number of seeds (default: %(default)s)")
    reader.add_argument("--write", type=Path, metavar="FOLDER", help="write the missions there instead of flying them")
    given = reader.parse_args()
    if given.write is not None:
        write(given.write)
    else:
        main(given.count)
