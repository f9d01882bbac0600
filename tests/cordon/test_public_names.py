"""The public names of cordon: what they are, that they are described, and that importing them costs little."""

import ast
import doctest
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest

import cordon

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
