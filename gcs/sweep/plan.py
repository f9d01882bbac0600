"""The plan of a sweep: everything that its runs depend on, fixed when it starts, and the runs that follow from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import msgspec

from gcs.errors import InputError
from gcs.flightlog.run import versions
from gcs.mission.file import MissionError, mission_path, mission_text, parse_mission
from gcs.mission.mission import Mission
from gcs.mission.overrides import overridden
from gcs.sweep.variation import Variation

SEED_PLACE, DURATION_PLACE = "mission.seed", "mission.duration_s"


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a sweep: its place in the order of the table, the varied values by their places, and its seed."""

    index: int
    values: Mapping[str, Any]
    seed: int


class Task(msgspec.Struct, frozen=True):
    """What a worker needs to fly one run. `versions` are those of the computer that planned it."""

    mission_text: str
    profile_texts: Mapping[str, str]
    seed: int
    duration_s: float | None
    versions: Mapping[str, str]


class SweepPlan(msgspec.Struct, frozen=True):
    """What a sweep flies: a mission's text, values in place of it (`fixed` for all runs), and the seeds.

    Two sweeps with equal plans have the same table. `duration_s` is None for the mission's. `versions` are those of
    what a computed number depends on.
    """

    mission_text: str
    profile_texts: dict[str, str]
    fixed: dict[str, Any]
    variations: tuple[Variation, ...]
    seeds: tuple[int, ...]
    duration_s: float | None
    versions: dict[str, str]

    @property
    def combinations(self) -> list[dict[str, Any]]:
        """The varied values by their places, in the order of the table: the last key varies fastest."""
        places = [each.place for each in self.variations]
        every = product(*(each.values for each in self.variations))
        return [dict(zip(places, values, strict=True)) for values in every]

    @property
    def runs(self) -> list[Run]:
        """All runs in the order of the table: the seeds vary fastest."""
        every = product(self.combinations, self.seeds)
        return [Run(index, values, seed) for index, (values, seed) in enumerate(every)]

    @property
    def line(self) -> str:
        """The plan in a line: how many of what, and the first values."""
        varied = [f"{len(each.values)} of {each.place} ({_some(each.values)})" for each in self.variations]
        seeds = f"{counted(len(self.seeds), 'seed')} ({_some(self.seeds)})"
        return f"{counted(len(self.runs), 'run')}: {' × '.join([*varied, seeds])}"

    def task(self, run: Run) -> Task:
        """Return what flies a run."""
        text = overridden(self.mission_text, {**self.fixed, **run.values})
        return Task(text, self.profile_texts, run.seed, self.duration_s, self.versions)

    def differences(self, other: "SweepPlan") -> list[str]:
        """Return in which parts the other plan differs."""
        names = {"fixed": "values of --set", "variations": "varied values", "profile_texts": "profiles"}
        return [
            names.get(field, field.replace("_", " "))
            for field in SweepPlan.__struct_fields__
            if msgspec.json.encode(getattr(self, field)) != msgspec.json.encode(getattr(other, field))
        ]


def planned(
    mission: str,
    variations: Sequence[Variation],
    seeds: Sequence[int],
    fixed: Mapping[str, Any],
    duration_s: float | None,
) -> tuple[SweepPlan, dict[int, str]]:
    """Return the plan of a sweep, and what is wrong with the missions of some runs, by the runs' indexes.

    Without seeds the mission's own is the only one. Raises InputError where no run has a mission that can be flown,
    and for keys that cannot be varied.
    """
    _require_variable([each.place for each in variations], fixed, bool(seeds), duration_s)
    text, folder = mission_text(mission), mission_path(mission).parent
    profile_texts: dict[str, str] = {}
    here = {each.name: each.version for each in versions()}
    plan = SweepPlan(text, {}, dict(fixed), tuple(variations), tuple(seeds), duration_s, here)
    flyable: Mission | None = None
    faults: dict[int, InputError] = {}
    for index, values in enumerate(plan.combinations):
        try:
            parsed = parse_mission(overridden(text, plan.fixed | values), folder, profile_texts)
        except InputError as error:
            faults[index] = error
        else:
            flyable, profile_texts = flyable or parsed, dict(parsed.profile_texts)
    if flyable is None:
        raise MissionError(faults[0].faults)
    plan = msgspec.structs.replace(plan, seeds=tuple(seeds) or (flyable.mission.seed,), profile_texts=profile_texts)
    seeds_each = len(plan.seeds)
    reasons = {index: "; ".join(error.faults) for index, error in faults.items()}
    return plan, {index * seeds_each + k: text for index, text in reasons.items() for k in range(seeds_each)}


def _require_variable(
    places: Sequence[str], fixed: Mapping[str, Any], seeds_given: bool, duration_s: float | None
) -> None:
    """Raise InputError for places that are given twice, or that another option decides."""
    faults = [f"--vary {place}: given twice" for place in dict.fromkeys(places) if places.count(place) > 1]
    faults += [f"--vary {place}: --set gives it a value too: leave one out" for place in places if place in fixed]
    if SEED_PLACE in places or (SEED_PLACE in fixed and seeds_given):
        faults.append(f"{SEED_PLACE}: --seeds chooses the seeds: leave it out")
    if DURATION_PLACE in {*places, *fixed} and duration_s is not None:
        faults.append(f"{DURATION_PLACE}: --duration decides it: leave one out")
    if faults:
        raise InputError(faults)


def counted(count: int, name: str) -> str:
    """Return how many of something: `1 run`, `2 runs`."""
    return f"{count} {name}{'' if count == 1 else 's'}"


def _some(values: Sequence[Any]) -> str:
    """Return values in a few words: all of up to six, else the first and the last."""
    shown = [str(value) for value in values]
    return ", ".join(shown if len(shown) <= 6 else [*shown[:3], "...", shown[-1]])
