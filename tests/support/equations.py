"""The paper's equations, and their functions, whose docstring's first line ends with the numbers.

For example: `Return the bearings of all engaged peers at a time - (25), (26).`
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator

from tests.support.paths import ROOT

EQUATIONS = {
    1: "error dynamics of two successive vehicles in formation",
    2: "their output: the distances in x and y",
    3: "the plant in polar coordinates about the target",
    4: "position and velocity from polar coordinates",
    5: "polar rates and accelerations from Cartesian ones",
    6: "the Cartesian position of a vehicle",
    7: "its polar position about the target",
    8: "C1: every radius becomes R_D",
    9: "C2: every angular rate becomes that of the ring",
    10: "C3: every spacing becomes 2π/N",
    11: "the inputs u1, u2 that make the polar plant linear",
    12: "the linear plant: two double integrators",
    13: "cost of the formation's LMPC",
    14: "its error: predicted state less reference",
    15: "the even spacing 2π/N",
    16: "the angle between neighbours",
    17: "error of a spacing",
    18: "Lyapunov function of the spacings",
    19: "what the rates of neighbours must differ by",
    20: "decay of the Lyapunov function",
    21: "the mean rate of the ring",
    22: "the spacing law: a rate for each vehicle",
    23: "cost of the ring's LMPC",
    24: "its terms: radius and rate, spacing behind, spacing in front",
    25: "prediction of the vehicle in front",
    26: "prediction of the vehicle behind",
}
"""The content of each equation by its number in the paper."""
NUMBER = r"\((\d{1,2})[a-d]?\)"
_IMPLEMENTS = re.compile(rf" - ({NUMBER}(?:(?:, | to | and ){NUMBER})*)\.$")
_SPAN = re.compile(rf"{NUMBER}(?: to {NUMBER})?")


def equation_table() -> str:
    """Return every equation with its content and the functions that implement it, as Markdown."""
    by_number = implementations()
    rows = ["| equation | states | in cordon |", "|---|---|---|"]
    for number, statement in EQUATIONS.items():
        names = ", ".join(f"`{name}`" for name in by_number.get(number, []))
        rows.append(f"| ({number}) | {statement} | {names} |")
    return "\n".join(rows)


def implementations() -> dict[int, list[str]]:
    """Return the public functions and classes that implement each equation, by its number."""
    found = defaultdict(list)
    for name, text in docstrings():
        if "._" in name:
            continue
        cited = _IMPLEMENTS.search(" ".join(text.split("\n\n")[0].split()))
        for span in _SPAN.finditer(cited[1]) if cited else ():
            for number in range(int(span[1]), int(span[2] or span[1]) + 1):
                found[number].append(name)
    return dict(found)


def docstrings() -> Iterator[tuple[str, str]]:
    """Return all docstrings by the full names of their objects."""
    for package in ("agents", "estimation", "gcs"):
        for path in sorted((ROOT / package).rglob("*.py")):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            yield from _documented(ast.parse(path.read_text(encoding="utf-8")), module)


def _documented(node: ast.Module | ast.ClassDef | ast.FunctionDef, name: str) -> Iterator[tuple[str, str]]:
    yield name, ast.get_docstring(node) or ""
    for each in node.body:
        if isinstance(each, ast.ClassDef | ast.FunctionDef):
            yield from _documented(each, f"{name}.{each.name}")
