"""What a command leaves behind: JSON for scripts, text for people, a figure where it was asked for."""

import json
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from gcs.cli import output
from gcs.cli.output import SimulationProgress, check_plot, present
from gcs.errors import Exit, InputError
from gcs.flight.simulated import fly_simulated
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission


@pytest.fixture(scope="module")
def mission() -> Mission:
    return load_mission("case1")


@pytest.fixture(scope="module")
def record(mission: Mission) -> FlightRecord:
    """A flight that has just begun: nothing can have gone wrong yet."""
    return fly_simulated(mission, 3, 2.0, lambda _: None)


# Figures are refused before anything flies


@pytest.mark.parametrize("name", ["flight.png", "flight.svg", "flight.pdf", "FLIGHT.PNG", "a[b].png", "two words.svg"])
def test_a_figure_that_can_be_written_is_no_fault(tmp_path: Path, name: str) -> None:
    check_plot(tmp_path / name)


def test_no_figure_is_no_fault() -> None:
    check_plot(None)


def test_a_figure_beside_the_reader_needs_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    check_plot(Path("flight.png"))


@pytest.mark.parametrize("name", ["flight.bmp", "flight", "flight.png.txt", "png", "", "."])
def test_a_figure_of_an_unknown_kind_names_the_known_ones(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"--plot: .* must end in \.png, \.svg, \.pdf"):
        check_plot(tmp_path / name if name else Path())


def test_a_figure_into_no_folder_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "missing", tmp_path / "file"):
        with pytest.raises(InputError, match="--plot: no folder"):
            check_plot(folder / "flight.png")


def test_a_figure_in_place_of_a_folder_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "flight.png").mkdir()
    with pytest.raises(InputError, match=r"--plot: .*flight\.png"):
        check_plot(tmp_path / "flight.png")


@pytest.mark.parametrize(
    ("number", "path", "fault"), [(7, "a.png", "--figure: the paper has no figure 7"), (4, None, "add --plot")]
)
def test_a_figure_that_the_paper_lacks_or_without_a_file_is_a_fault(number: int, path: str | None, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        check_plot(None if path is None else Path(path), number)


# The result


def test_json_is_one_line_on_standard_output_and_text_is_elsewhere(
    mission: Mission, record: FlightRecord, capsys: pytest.CaptureFixture[str]
) -> None:
    assert present(mission, record, json=True, plot=None) is Exit.HOLDS
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert out.count("\n") == 1
    assert (result["mission"], result["seed"], result["duration_s"]) == ("case1", 3, 2.0)
    assert result["wall_time_s"] > 0.0
    assert result["loop"]["tick_p50_us"] > 0.0
    assert "case1" in err
    assert "{" not in err


def test_without_json_standard_output_stays_empty(
    mission: Mission, record: FlightRecord, capsys: pytest.CaptureFixture[str]
) -> None:
    present(mission, record, json=False, plot=None)
    out, err = capsys.readouterr()
    assert out == ""
    assert "separation" in err


def test_an_untimed_result_holds_no_wall_time(
    mission: Mission, record: FlightRecord, capsys: pytest.CaptureFixture[str]
) -> None:
    present(mission, record, json=True, plot=None, timed=False)
    result = json.loads(capsys.readouterr().out)
    timed = (
        result["wall_time_s"],
        result["realtime_factor"],
        result["loop"]["tick_p50_us"],
        result["loop"]["tick_p99_us"],
    )
    assert timed == (None,) * 4
    assert result["loop"]["ticks"] == 63


def test_a_verdict_that_does_not_hold_is_an_exit_code(record: FlightRecord) -> None:
    # Case 1's vehicles start 4 m apart.
    case1 = load_mission("case1")
    strict = case1.safety.model_copy(update={"separation_m": 4.5})
    failing = Mission(**{name: getattr(case1, name) for name in Mission.__slots__} | {"safety": strict})
    assert present(failing, record, json=False, plot=None) is Exit.VERDICT_FAILED


@pytest.mark.parametrize("name", ["flight.svg", "a[/b].svg", "a[bold]b.svg"])
def test_a_figure_is_written_and_its_name_is_told_as_it_is(
    mission: Mission, record: FlightRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    present(mission, record, json=False, plot=path)
    assert path.read_bytes().startswith(b"<?xml")
    assert f"figure: {path}\n" in capsys.readouterr().err


def test_a_figure_that_cannot_be_written_after_all_is_told(
    mission: Mission, record: FlightRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "gone" / "flight.png"
    with pytest.raises(InputError, match=r"--plot: .*gone"):
        present(mission, record, json=True, plot=path)


# Progress


def test_progress_is_silence_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with SimulationProgress("case1", 10.0) as progress:
        for flown_s in range(11):
            progress.update(float(flown_s))
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["case1", "{braces}", "[bold]brackets[/bold]", "50 %"])
def test_progress_on_a_terminal_names_the_mission_as_it_is(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = StringIO()
    monkeypatch.setattr(output, "STDERR", Console(file=screen, force_terminal=True, width=120, color_system=None))
    with SimulationProgress(name, 10.0) as progress:
        for flown_s in range(8):
            progress.update(float(flown_s))
    assert f"{name}: 7 of 10 s flown" in screen.getvalue()


def test_a_simulation_imports_no_link_no_bus_and_no_viewer() -> None:
    """Each takes longer to import than a short mission takes to fly."""
    heavy = ("mavsdk", "zenoh", "foxglove", "mcap", "psutil", "matplotlib", "pymavlink")
    program = (
        f"import sys, gcs.cli.output, gcs.flight.simulated; print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "[]\n"
