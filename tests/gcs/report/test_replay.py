"""What a report holds for its replay: the operator's page as it is, and the flight as the page shows it."""

import re
import stat
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest

from gcs.cli.report import ReportOptions, report
from gcs.flightlog.reader import read_log
from gcs.report import flight_page
from gcs.report.flight_page import replay_flight
from gcs.station.recorded_flight import recorded_flight
from tests.support.flight_logs import engaging, part, record_simulation
from tests.support.page.report_replay import held_files
from tests.support.paths import DATA, ROOT

pytestmark = pytest.mark.slow

PAGE = ROOT / "gcs" / "station" / "page"
DURATION_S = 30.0


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    record_simulation(engaging(), path, duration_s=DURATION_S)
    return path


@pytest.fixture(scope="module")
def html(path: Path) -> str:
    written = path.with_name("flight.html")
    report([path], options=ReportOptions(html=written))
    return written.read_text(encoding="utf-8")


def test_the_replay_comes_before_every_figure_and_takes_its_room(html: str, path: Path) -> None:
    assert html.index('<section id="verdicts"') < html.index('<section id="replay"') < html.index("<figure")
    assert len(html.encode()) < 5_000_000
    assert stat.S_IMODE(path.with_name("flight.html").stat().st_mode) == 0o600, "it is the user's own"


def test_it_is_the_operators_page_file_by_file_and_the_flight_as_recorded(html: str, path: Path) -> None:
    files = held_files(html)
    flight = files.pop("flight.json")
    assert flight == msgspec.json.encode(recorded_flight(read_log(path))).decode()
    loaded = {each for each in PAGE.rglob("*.*") if each.suffix not in (".md", ".txt")}
    assert files == {each.relative_to(PAGE).as_posix(): each.read_text(encoding="utf-8") for each in loaded}
    for licence in PAGE.rglob("*.LICENSE.txt"):
        assert licence.read_text(encoding="utf-8").splitlines()[0] in html


def test_every_file_that_the_page_names_is_held(html: str) -> None:
    """The report finds names in `from`, `import` and `resolve` of modules, and in links and scripts of the page."""
    files = held_files(html)
    named = re.findall(r'(?:href|src)="([^"#]+)"', files["index.html"])
    for name, text in files.items():
        if name.endswith(".js") and not name.startswith("vendor/"):
            named += (each.removeprefix("./") for each in re.findall(r'"(\./[^"]+)"', text))
            assert re.findall(r'"\./', text) == re.findall(r'(?<=from |port\(|olve\()"\./', text)
    assert len(named) > 40
    assert set(named) <= set(files)


def test_logs_of_several_processes_are_replayed_as_one_flight(path: Path) -> None:
    log = read_log(path)
    whole, merged = replay_flight(log), replay_flight(part(log, 3), part(log, 1, 2))
    assert merged.teams == whole.teams
    assert merged.mission == whole.mission
    told = ({(each.time_s, each.vehicle_id, each.text) for each in flight.events} for flight in (whole, merged))
    assert next(told) == next(told)


def test_a_long_flight_is_shown_at_a_lower_but_even_rate(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight_page, "_VEHICLE_PICTURES", 120)
    log = read_log(path)
    shown, whole = replay_flight(log), recorded_flight(log)
    assert 38 <= len(shown.teams) <= 42, "three vehicles"
    steps_s = [b.wall_s - a.wall_s for a, b in pairwise(shown.teams)]
    assert steps_s == pytest.approx([DURATION_S / 40.0] * len(steps_s), rel=0.01)
    assert shown.events == whole.events
    assert shown.teams[-1].ending == whole.teams[-1].ending != ""


def test_without_a_page_nothing_of_the_station_is_loaded(path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from gcs.cli.report import ReportOptions, report;"
        f"report([Path({str(path)!r})], options=ReportOptions(json=True));"
        f"report([Path({str(DATA / 'px4-quad.ulg')!r})], options=ReportOptions(json=True));"
        "print([name for name in sys.modules if name.startswith('gcs.station')], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "[]"
