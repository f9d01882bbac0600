"""The public names of cordon: what they are, that they are described, and that importing them costs little."""

import ast
import doctest
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest

import cordon
from cordon.docstrings import documented
from tests.support.public_names import name_sections

HEAVY = (
    "numpy",
    "pydantic",
    "scipy",
    "matplotlib",
    "msgspec",
    "agents",
    "gcs",
    "sitl",
    "estimation",
    "importlib.metadata",
)
MODULES = sorted(module.name for module in pkgutil.iter_modules(cordon.__path__, "cordon."))


def test_importing_cordon_imports_nothing_heavy() -> None:
    program = f"import sys, cordon; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_the_pytest_plugin_imports_nothing_heavy() -> None:
    program = f"import sys, cordon.pytest_plugin; print([name for name in {HEAVY[:-1]} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_simulation_imports_no_figure_no_frame_and_no_log() -> None:
    heavy = ("matplotlib", "pandas", "foxglove", "mavsdk", "zenoh")
    program = f"import sys, cordon; cordon.simulate; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_type_checkers_see_the_names_that_there_are() -> None:
    tree = ast.parse(Path(cordon.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    seen = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert seen == cordon._HOMES
    assert sorted(seen) == dir(cordon)


def test_public_names_are_described_and_typed(subtests: pytest.Subtests) -> None:
    for name in dir(cordon):
        with subtests.test(name):
            thing = getattr(cordon, name)
            if inspect.isfunction(thing):
                assert {*get_type_hints(thing)} == {*inspect.signature(thing).parameters, "return"}
            if inspect.isfunction(thing) or inspect.isclass(thing):
                assert thing.__doc__
                assert not thing.__doc__.startswith(f"{name}("), "made by dataclass"


SECTIONS = {
    text.partition("\n")[0]: text.partition("```py\n")[2].partition("```")[0] for text in name_sections().split("### ")
}
"""The signature of each public name, as on the page."""


def test_the_page_shows_attributes_members_and_plain_types() -> None:
    polar = cordon.Polar(8.0, 0.5, 0.1, 0.05)
    attributes = [line.split(":")[0].strip() for line in SECTIONS["Polar"].splitlines()[1:]]
    assert [getattr(polar, name) for name in attributes] == [8.0, 0.5, 0.1, 0.05]
    members = [line.strip() for line in SECTIONS["Tactic"].splitlines()[1:]]
    assert members == [f'{each.name} = "{each.value}"' for each in cordon.Tactic]
    for line in (
        "position_m: tuple[float, float]",
        'shape: Literal["line", "column", "wedge", "free"] | None = None',
    ):
        assert f"    {line}\n" in SECTIONS["MemberState"]
    assert "    acting_others: Mapping[str, NDArray[np.float64]]\n" in SECTIONS["Situation"]
    assert "    planner: Callable[[AgentConfig], TaskPlanner] | None = None,\n" in SECTIONS["simulate"]


def test_the_types_that_a_planner_receives_are_public() -> None:
    seen, waiting, others = set[str](), ["Task"], set[str]()
    while waiting:
        seen.add(name := waiting.pop())
        types = set(re.findall(r"\b[A-Z]\w*[a-z]\w*", SECTIONS[name].partition("\n    #")[0]))
        waiting += (types & {*dir(cordon)}) - seen
        others |= types - {*dir(cordon), "Enum", "None", "Literal", "Mapping", "NDArray"}
    assert seen > {"Task", "Situation", "Tactic", "MemberState", "NeighbourAngle", "Polar", "TargetEstimate"}
    assert others == {"Aircraft", "CommandedRing", "Drops", "Goal", "RingChoice", "TargetPackage"}, (
        "for cordon's own use"
    )


def test_a_class_without_docstring_has_that_of_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "compiled_one.py").write_text(
        'class One:\n    """One.\n\n    Its unit is m.\n    """\n\nclass Two: pass\n'
    )
    module = importlib.import_module("compiled_one")
    module.One.__doc__ = None  # as mypyc leaves it
    module.__file__ = str(tmp_path / "compiled_one.cpython-311-x86_64-linux-gnu.so")
    assert documented(module.One) is module.One
    assert module.One.__doc__ == "One.\n\nIts unit is m."
    (tmp_path / "compiled_one.py").write_text('class One:\n    """Another."""\n')
    assert documented(module.One).__doc__ == "One.\n\nIts unit is m.", "what there is stays"
    assert documented(module.Two).__doc__ is None
    (tmp_path / "compiled_one.py").unlink()
    assert documented(module.Two).__doc__ is None
    assert documented("text") == "text"


def test_a_name_that_there_is_not_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="simulat'"):
        cordon.simulat  # type: ignore[attr-defined]  # noqa: B018


def test_examples_in_docstrings_run() -> None:
    tried = 0
    for name in MODULES:
        results = doctest.testmod(importlib.import_module(name))
        assert results.failed == 0, f"{name}: its examples are printed above"
        tried += results.attempted
    assert tried > 0
