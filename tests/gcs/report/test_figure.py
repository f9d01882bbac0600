"""The figure of a flight: its formats, what is drawn in it, and flights in which there is little to draw."""

from dataclasses import replace
from math import tau
from pathlib import Path

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightRecord, LoopStatistics, VehicleTrack
from gcs.metrics.references import DesiredRing, FormationReference
from gcs.metrics.result import FlightResult
from gcs.report.figure import COLOURS, STYLE, save_figure
from tests.support.report_evidence import TOLERANCES

pytestmark = pytest.mark.slow

RING = DesiredRing(10.0, 0.05)
TIME_S = np.arange(601) / 1.0
TARGET_M = np.column_stack((35.0 + 0.1 * TIME_S, np.full(TIME_S.size, -5.0)))
TARGET_M_S = np.tile([0.1, 0.0], (TIME_S.size, 1))


def flight(count: int, engaging: int) -> tuple[FlightRecord, FlightResult, FormationReference]:
    """`count` vehicles in line; from 200 s on the first `engaging` of them jump onto a perfect ring."""
    slots = {index + 1: (0.0, 5.0 * ((count - 1) / 2 - index)) for index in range(count)}
    tracks = []
    for index, (vehicle_id, (x, y)) in enumerate(slots.items()):
        angle = index * tau / max(engaging, 1) + 0.05 * TIME_S
        around = np.column_stack((np.cos(angle), np.sin(angle)))
        forward = np.column_stack((-np.sin(angle), np.cos(angle)))
        line_m = np.column_stack((x + 0.2 * TIME_S, np.full(TIME_S.size, y)))
        encircling = (index < engaging) & (TIME_S >= 200.0)
        position = np.where(encircling[:, None], TARGET_M + 10.0 * around, line_m)
        velocity = np.where(encircling[:, None], TARGET_M_S + 0.5 * forward, [0.2, 0.0])
        tracks.append(VehicleTrack(vehicle_id, position, velocity, np.where(encircling, "encircle", "formation")))
    loop = LoopStatistics(10.0, 0, 0)
    flown = FlightRecord("case2", 0, "simulation", "truth", TIME_S, TARGET_M, TARGET_M_S, tuple(tracks), loop, 6.0)
    formation = FormationReference(0.2, slots)
    return flown, evaluate(flown, RING, formation, TOLERANCES), formation


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Collect the figures that save_figure would write."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    return figures


def panel(figure: Figure, title: str) -> Axes:
    (axes,) = [axes for axes in figure.axes if title in axes.get_title(loc="left")]
    return axes


@pytest.mark.parametrize(
    ("name", "again", "magic"),
    [("a.png", "again.PNG", b"\x89PNG"), ("b.svg", "again.svg", b"<?xml"), ("c.pdf", "again.pdf", b"%PDF")],
)
def test_the_suffix_chooses_the_format_and_the_file_repeats_byte_for_byte(
    tmp_path: Path, name: str, again: str, magic: bytes
) -> None:
    flown, result, formation = flight(1, 1)
    paths = [tmp_path / name, tmp_path / again]
    for path in paths:
        save_figure(flown, result, (RING,), path, formation, 2)
    assert paths[0].read_bytes().startswith(magic)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert b"Date" not in paths[0].read_bytes()


def test_another_suffix_is_refused_with_the_list(tmp_path: Path) -> None:
    flown, result, _ = flight(1, 0)
    with pytest.raises(ValueError, match=r"'flight\.gif'.*\.png, \.svg, \.pdf"):
        save_figure(flown, result, (RING,), tmp_path / "flight.gif")
    assert not list(tmp_path.iterdir())


def test_the_panels_draw_what_was_flown(tmp_path: Path, drawn: list[Figure]) -> None:
    flown, result, formation = flight(3, 3)
    save_figure(flown, result, (RING,), tmp_path / "flight.svg", formation)
    paths = panel(drawn[0], "paths")
    assert paths.get_aspect() == 1.0
    by_colour = {str(line.get_color()): line for line in paths.lines if len(np.atleast_1d(line.get_xdata())) > 1}
    for colour, track in zip(COLOURS, flown.vehicles, strict=False):
        assert np.array_equal(np.column_stack(by_colour[colour].get_data()), track.position_m)
    (ring,) = [patch for patch in paths.patches if isinstance(patch, Polygon)]
    assert np.hypot(*(ring.get_xy() - (95.0, -5.0)).T) == pytest.approx(10.0)
    for title, wanted in (("Speed", 0.2), ("Radius", 10.0), ("Angular velocity", 0.05), ("separation", 120.0)):
        lines = [np.asarray(line.get_ydata(), dtype=float) for line in panel(drawn[0], title).lines]
        assert len(lines) >= 4
        assert all(np.nanmax(np.abs(values - wanted)) < 1e-9 for values in lines)


def test_a_figure_of_the_paper_alone_has_the_panels_of_the_page(
    tmp_path: Path, drawn: list[Figure], subtests: pytest.Subtests
) -> None:
    flown, result, formation = flight(3, 3)
    save_figure(flown, result, (RING,), tmp_path / "page.svg", formation)
    wanted = {1: ["y"], 2: ["speed in x"], 3: ["radius", "angular velocity"], 4: ["y"], 6: ["spacing"]}
    for number, quantities in {**wanted, 5: wanted[3]}.items():
        with subtests.test(number=number):
            save_figure(flown, result, (RING,), tmp_path / "one.svg", formation, number)
            assert [axes.get_ylabel().split(" [")[0] for axes in drawn[-1].axes] == quantities
            for axes in drawn[-1].axes:
                page = panel(drawn[0], axes.get_title(loc="left"))
                lines = zip(axes.lines, page.lines, strict=True)
                assert all(np.array_equal(one.get_xydata(), other.get_xydata(), equal_nan=True) for one, other in lines)


def test_every_axis_states_its_unit(tmp_path: Path, drawn: list[Figure]) -> None:
    flown, result, formation = flight(3, 3)
    save_figure(flown, result, (RING,), tmp_path / "flight.png", formation)
    labels = [label for axes in drawn[0].axes for label in (axes.get_xlabel(), axes.get_ylabel())]
    assert len(labels) == 10
    assert all(label.endswith("]") for label in labels)


@pytest.mark.parametrize(("engaging", "reasons"), [(0, ["engaged"] * 3), (1, ["spacing"])])
def test_panels_without_data_say_why(tmp_path: Path, drawn: list[Figure], engaging: int, reasons: list[str]) -> None:
    flown, result, _ = flight(3, engaging)
    save_figure(flown, result, (RING,), tmp_path / "flight.png")
    assert [text.get_text().split()[-1] for axes in drawn[0].axes[1:] for text in axes.texts] == reasons


def test_sixteen_vehicles_are_told_apart(tmp_path: Path, drawn: list[Figure]) -> None:
    flown, result, formation = flight(16, 16)
    save_figure(flown, result, (RING,), tmp_path / "flight.png", formation)
    lines = [line for line in panel(drawn[0], "Radius").lines if str(line.get_label()).startswith("vehicle ")]
    looks = {(str(line.get_color()), str(line.get_linestyle()), str(line._dash_pattern)) for line in lines}  # type: ignore[attr-defined]
    assert len(looks) >= 16
    assert {text.get_text() for text in panel(drawn[0], "paths").texts} == {str(i) for i in range(1, 17)}


def test_vehicles_and_targets_not_heard_are_drawn_around(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    flown, _, formation = flight(3, 3)
    silent = np.full_like(TARGET_M, np.nan)
    unheard = replace(flown.vehicles[0], position_m=silent, velocity_m_s=silent, tactic=np.full(TIME_S.size, "unknown"))
    mute = replace(flown, vehicles=(unheard, *flown.vehicles[1:]))
    save_figure(mute, evaluate(mute, RING, formation, TOLERANCES), (RING,), tmp_path / "mute.png")
    blind = replace(flown, target_position_m=silent, target_velocity_m_s=silent)
    save_figure(blind, evaluate(blind, RING, formation, TOLERANCES), (RING,), tmp_path / "blind.png")
    assert not recwarn.list


def test_the_style_is_not_left_behind(tmp_path: Path) -> None:
    flown, result, formation = flight(1, 0)
    before = rcParams["axes.grid"]
    assert STYLE["axes.grid"] != before
    save_figure(flown, result, (RING,), tmp_path / "flight.png", formation, 2)
    assert rcParams["axes.grid"] == before
