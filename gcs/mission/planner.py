"""A user's planner: from its name in a mission, where the user allows its code, to what makes it.

The name is `module:Class`, or that of an entry point of the group `cordon.planners`. A mission may come from elsewhere:
nothing that it names is imported unless the user says so.
"""

import inspect
import os
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, entry_points, packages_distributions, version
from pathlib import Path

from agents.control.plan import PlannerFactory
from gcs.errors import InputError
from gcs.mission.mission import CORDONS_PLANNER, Mission

GROUP = "cordon.planners"
VARIABLE = "CORDON_ALLOW_PLUGINS"
"""The environment variable by which a user allows planners of missions and logs: 1."""


@dataclass(frozen=True, slots=True)
class ChosenPlanner:
    """A planner that is not cordon's: its name, and what makes it for a vehicle.

    `distribution` is that of its module, with the version, and `digest` that of its source file, 16 hexadecimal digits;
    both are empty where they are not known.
    """

    name: str
    factory: PlannerFactory
    distribution: str
    digest: str


def given_planner(factory: object, name: str = "") -> ChosenPlanner:
    """Return the planner that a class or function makes; raises InputError for anything else, such as an instance."""
    if not callable(factory):
        hint = "; this is an instance: leave out the parentheses" if hasattr(factory, "plan") else ""
        raise InputError([f"planner: {name or repr(factory)}: give a class, or a function of the AgentConfig{hint}"])
    module = getattr(factory, "__module__", "")
    if inspect.isclass(factory) and not callable(getattr(factory, "plan", None)):
        raise InputError([f"planner: {name or repr(factory)}: the class has no method plan(task)"])
    name = name or f"{module}:{getattr(factory, '__qualname__', type(factory).__qualname__)}"
    return ChosenPlanner(name, factory, _distribution(module), _digest(factory))


def named_planner(name: str, *, allowed: bool) -> ChosenPlanner:
    """Import a planner by its name; raises InputError if that fails, or if neither `allowed` nor the variable is set.

    `allowed` is `--allow-plugins` of the command line.
    """
    if not (allowed or os.environ.get(VARIABLE) == "1"):
        how = f"if you trust it, allow it by --allow-plugins or {VARIABLE}=1"
        raise InputError([f"mission.planner: {name!r} is code of its own, which is not run: {how}"])
    return given_planner(_imported(name), name)


def own_planner(mission: Mission) -> str:
    """Return the name of the planner that a mission flies, empty for cordon's, which flies all identification."""
    name = mission.mission.planner
    return "" if name == CORDONS_PLANNER or mission.excites else name


def planner_of(mission: Mission, *, allowed: bool) -> ChosenPlanner | None:
    """Return the planner that a mission names, None for cordon's; raises InputError as `named_planner` does."""
    name = own_planner(mission)
    return named_planner(name, allowed=allowed) if name else None


def require_loaded(mission: Mission, planner: ChosenPlanner | None, verb: str) -> None:
    """Raise InputError if a mission names a planner that was not loaded: it would fly with cordon's instead."""
    if planner is None and (name := own_planner(mission)):
        cordons = f"--set mission.planner={CORDONS_PLANNER}, or this key in a copy of the mission, flies cordon's"
        raise InputError([f"mission.planner: {verb} does not fly {name!r}: {cordons}"])


def _imported(name: str) -> object:
    module, colon, attribute = name.partition(":")
    try:
        if not colon:
            known = entry_points(group=GROUP)
            if name not in known.names:
                names = ", ".join(sorted(known.names)) or "none"
                hint = f"write module:Class, or an entry point of {GROUP} (installed: {names})"
                raise InputError([f"mission.planner: {name!r}: {hint}"])
            return known[name].load()
        found: object = import_module(module)
        for each in attribute.split("."):
            found = getattr(found, each)
    except InputError:
        raise
    except Exception as error:  # whatever its module raises as it is imported
        hint = "install its package, or add its folder to PYTHONPATH"
        raise InputError([f"mission.planner: {name!r}: {type(error).__name__}: {error}; {hint}"]) from error
    return found


def _distribution(module: str) -> str:
    found = packages_distributions().get(module.partition(".")[0], [])
    try:
        return f"{found[0]} {version(found[0])}" if found else ""
    except PackageNotFoundError:
        return ""


def _digest(factory: object) -> str:
    """Return the digest of the source file of a class or function, empty without one."""
    try:
        path = inspect.getsourcefile(factory)  # type: ignore[arg-type]  # what has no file raises TypeError
        return "" if path is None else sha256(Path(path).read_bytes()).hexdigest()[:16]
    except (OSError, TypeError):
        return ""
