"""The house rules that a machine can hold: files stay short, only the command line prints, the core stays pure."""

import ast
from functools import cache

import pytest

from tests.support.paths import ROOT

SOURCES = sorted(path for package in ("agents", "estimation", "gcs", "sitl") for path in (ROOT / package).rglob("*.py"))
NAMES = [str(path.relative_to(ROOT)) for path in SOURCES]

LINES_MAX = 400
FUNCTION_LINES_MAX = 60
PRINTERS = {"gcs/cli/app.py", "gcs/cli/output.py"}

# The shell, which may look at clocks and sockets. Every other file of these packages is core, also one added tomorrow.
SHELL = {
    "agents/shell/activities.py",
    "agents/shell/agent.py",
    "agents/shell/clock.py",
    "agents/shell/control_loop.py",
    "agents/shell/outcome.py",
    "agents/shell/start_agreement.py",
    "agents/shell/ticker.py",
    "agents/shell/zenoh_bus.py",
    "sitl/server/process.py",
    "sitl/server/server.py",
    "sitl/simulation/simulation.py",  # times the ticks; the flight itself knows simulated time only
}
CORE = [name for name in NAMES if name.startswith(("agents/", "estimation/", "sitl/")) and name not in SHELL]
IMPURE = {
    "asyncio",
    "datetime",
    "multiprocessing",
    "os",
    "random",
    "secrets",
    "signal",
    "socket",
    "subprocess",
    "threading",
    "time",
    "uuid",
}


@cache
def tree(name: str) -> ast.Module:
    return ast.parse((ROOT / name).read_text(encoding="utf-8"))


def imported(name: str) -> set[str]:
    """The top-level modules that a file imports, wherever in it."""
    modules: set[str] = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            modules |= {alias.name.partition(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            modules.add(node.module.partition(".")[0])
    return modules


def called(name: str) -> set[str]:
    """The dotted names of what a file calls, as far as they are names: `print`, `np.random.normal`."""
    calls = (node.func for node in ast.walk(tree(name)) if isinstance(node, ast.Call))
    return {ast.unparse(function) for function in calls if isinstance(function, ast.Name | ast.Attribute)}


def test_there_are_sources() -> None:
    assert {"gcs/cli/app.py", "agents/core.py", "estimation/filters/own.py", "sitl/autopilot/px4.py"} <= set(NAMES)
    assert set(NAMES) >= SHELL, "the table of the shell names a file that is gone"


@pytest.mark.parametrize("name", NAMES)
def test_files_stay_short(name: str) -> None:
    assert len((ROOT / name).read_text(encoding="utf-8").splitlines()) <= LINES_MAX


@pytest.mark.parametrize("name", NAMES)
def test_functions_stay_short(name: str) -> None:
    functions = (node for node in ast.walk(tree(name)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    long = {node.name for node in functions if (node.end_lineno or 0) - node.lineno >= FUNCTION_LINES_MAX}
    assert not long


@pytest.mark.parametrize("name", sorted(set(NAMES) - PRINTERS))
def test_only_the_command_line_prints(name: str) -> None:
    assert not called(name) & {"print", "input", "sys.stdout.write", "sys.stderr.write"}


@pytest.mark.parametrize("name", CORE)
def test_the_core_is_deaf_blind_and_timeless(name: str) -> None:
    assert not imported(name) & IMPURE


@pytest.mark.parametrize("name", CORE)
def test_chance_in_the_core_has_a_seed(name: str) -> None:
    drawn = {call for call in called(name) if call.startswith(("np.random.", "numpy.random."))}
    assert drawn <= {"np.random.default_rng"}
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "np.random.default_rng":
            assert node.args or node.keywords, f"line {node.lineno}: a generator without a seed"
