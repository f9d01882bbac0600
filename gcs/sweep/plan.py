"""The plan of a sweep: everything that its runs depend on, fixed at the start, and the list of runs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import msgspec

from gcs.errors import InputError
from gcs.flightlog.run import versions
from gcs.mission.file import MissionError, mission_path, mission_text, parse_mission
from gcs.mission.mission import Mission
from gcs.mission.overrides import overridden
from gcs.mission.planner import named_planner, own_planner
from gcs.sweep.variation import Variation

SEED_PLACE, DURATION_PLACE, PLANNER_PLACE = "mission.seed", "mission.duration_s", "mission.planner"


@dataclass(frozen=True, slots=True)
class SweepRun:
    """One run of a sweep: its index in the table, the varied values by their paths, and its seed."""

    index: int
    values: Mapping[str, Any]
    seed: int


class SweepTask(msgspec.Struct, frozen=True):
    """The input of a worker for one run. `versions` are those of the computer that planned it.

    `planners` are the users' planners that were allowed there, each with the digest of its source.
    """

    mission_text: str
    profile_texts: Mapping[str, str]
    seed: int
    duration_s: float | None
    versions: Mapping[str, str]
    planners: Mapping[str, str] = {}


class SweepPlan(msgspec.Struct, frozen=True):
    """The content of a sweep: a mission's text, overrides (`fixed` ones for all runs), and the seeds.

    Two sweeps with equal plans have the same table. `duration_s` is None for the mission's. `versions` are those of
    all packages that results depend on, `planners` the digests of the sources of users' planners, by their names.
    """

    mission_text: str
    profile_texts: dict[str, str]
    fixed: dict[str, Any]
    variations: tuple[Variation, ...]
    seeds: tuple[int, ...]
    duration_s: float | None
    versions: dict[str, str]
    planners: dict[str, str] = {}

    @property
    def combinations(self) -> list[dict[str, Any]]:
        """The combinations of varied values by their paths, in the order of the table: the last key varies fastest."""
        places = [each.place for each in self.variations]
        every = product(*(each.values for each in self.variations))
        return [dict(zip(places, values, strict=True)) for values in every]

    @property
    def runs(self) -> list[SweepRun]:
        """All runs in the order of the table: the seeds vary fastest."""
        every = product(self.combinations, self.seeds)
        return [SweepRun(index, values, seed) for index, (values, seed) in enumerate(every)]

    @property
    def line(self) -> str:
        """The plan in one line: numbers of runs, values and seeds, and some of the values."""
        varied = [f"{len(each.values)} of {each.place} ({_some(each.values)})" for each in self.variations]
        seeds = f"{counted(len(self.seeds), 'seed')} ({_some(self.seeds)})"
        return f"{counted(len(self.runs), 'run')}: {' × '.join([*varied, seeds])}"

    def differences(self, other: "SweepPlan") -> list[str]:
        """Return the parts in which the other plan differs."""
        names = {
            "fixed": "values of --set",
            "variations": "varied values",
            "profile_texts": "profiles",
            "planners": "sources of planners",
        }
        return [
            names.get(field, field.replace("_", " "))
            for field in SweepPlan.__struct_fields__
            if msgspec.json.encode(getattr(self, field)) != msgspec.json.encode(getattr(other, field))
        ]


class Tasks:
    """The inputs of workers for the runs of a plan. Consecutive runs with the same values share a mission text."""

    def __init__(self, plan: SweepPlan) -> None:
        self._plan = plan
        self._values: Mapping[str, Any] | None = None
        self._text = ""

    def of(self, run: SweepRun) -> SweepTask:
        """Return a worker's input for a run."""
        plan = self._plan
        if run.values != self._values:
            self._values, self._text = run.values, overridden(plan.mission_text, {**plan.fixed, **run.values})
        return SweepTask(self._text, plan.profile_texts, run.seed, plan.duration_s, plan.versions, plan.planners)


def planned(
    mission: str,
    variations: Sequence[Variation],
    seeds: Sequence[int],
    fixed: Mapping[str, Any],
    duration_s: float | None,
    inspect: Callable[[Mission], None] = lambda _: None,
    interrupted: Callable[[], bool] = lambda: False,
    *,
    allow_plugins: bool = False,
) -> tuple[SweepPlan, dict[int, str]]:
    """Return the plan of a sweep, and the faults of runs with invalid missions, by run index; `inspect` the valid ones.

    Without seeds, the mission's is the only one. Users' planners are imported if `allow_plugins`. Raises InputError if
    no run has a valid mission, for keys that cannot be varied, and for planners that are not allowed or cannot be
    imported; KeyboardInterrupt when `interrupted`.
    """
    _require_variable([each.place for each in variations], fixed, bool(seeds), duration_s)
    text, folder = mission_text(mission), mission_path(mission).parent
    profile_texts: dict[str, str] = {}
    here = {each.name: each.version for each in versions()}
    plan = SweepPlan(text, {}, dict(fixed), tuple(variations), tuple(seeds), duration_s, here)
    flyable: Mission | None = None
    faults: dict[int, InputError] = {}
    named: dict[str, None] = {}
    for index, values in enumerate(plan.combinations):
        if interrupted():
            raise KeyboardInterrupt
        try:
            parsed = parse_mission(overridden(text, plan.fixed | values), folder, profile_texts)
        except InputError as error:
            faults[index] = error
        else:
            flyable, profile_texts = flyable or parsed, dict(parsed.profile_texts)
            inspect(parsed)
            named |= dict.fromkeys(filter(None, [own_planner(parsed)]))
    planners = _digests(named, allowed=allow_plugins)
    if flyable is None:
        raise MissionError(faults[0].faults)
    seeds = tuple(seeds) or (flyable.mission.seed,)
    plan = msgspec.structs.replace(plan, seeds=seeds, profile_texts=profile_texts, planners=planners)
    seeds_each = len(plan.seeds)
    reasons = {index: "; ".join(error.faults) for index, error in faults.items()}
    return plan, {index * seeds_each + k: text for index, text in reasons.items() for k in range(seeds_each)}


def _digests(names: Iterable[str], *, allowed: bool) -> dict[str, str]:
    """Import users' planners and return the digests of their sources by name; raises InputError with every fault."""
    digests, faults = dict[str, str](), list[str]()
    for name in names:
        try:
            digests[name] = named_planner(name, allowed=allowed).digest
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return digests


def _require_variable(
    places: Sequence[str], fixed: Mapping[str, Any], seeds_given: bool, duration_s: float | None
) -> None:
    """Raise InputError for paths that are given twice, or that another option sets."""
    faults = [f"--vary {place}: given twice" for place in dict.fromkeys(places) if places.count(place) > 1]
    faults += [f"--vary {place}: --set sets it, too: leave one of them out" for place in places if place in fixed]
    if SEED_PLACE in places or (SEED_PLACE in fixed and seeds_given):
        faults.append(f"{SEED_PLACE}: --seeds sets the seeds: leave this key out")
    if DURATION_PLACE in {*places, *fixed} and duration_s is not None:
        faults.append(f"{DURATION_PLACE}: --duration sets it, too: leave one of them out")
    if faults:
        raise InputError(faults)


def counted(count: int, name: str) -> str:
    """Return a count with its noun: `1 run`, `2 runs`."""
    return f"{count} {name}{'' if count == 1 else 's'}"


def _some(values: Sequence[Any]) -> str:
    """Return a short list of values: all of up to six, otherwise the first three and the last."""
    shown = [str(value) for value in values]
    return ", ".join(shown if len(shown) <= 6 else [*shown[:3], "...", shown[-1]])
