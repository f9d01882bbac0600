"""The page of a flight: complete, self-contained, safe to open, small, and silent about what is not known."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure

from gcs.metrics.catalogue import Verdicts
from gcs.metrics.metrics import evaluate
from gcs.metrics.result import EstimateResult, judged_line
from gcs.metrics.ring import RingResult
from gcs.metrics.vehicles import EstimatedVehicleResult
from gcs.report.charts.chart import chart
from gcs.report.charts.metrics import running_rms
from gcs.report.charts.onboard import draw_yaws
from gcs.report.charts.panels import title
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.flight_page import report_html, write_report
from gcs.report.sections import flight_of, sections
from gcs.report.summary import headline, summary, verdicts
from gcs.station.picture import FlightPicture
from tests.support.page.report_replay import held_files, nasty_flight
from tests.support.page.station_pictures import ring_flight
from tests.support.report_evidence import OWN_SIGMA_M, TARGET_SIGMA_M, TOLERANCES, flown

pytestmark = pytest.mark.slow

NASTY = "</script><script>alert('&')</script><!-- $x_1$ ${alert(1)} \u2028 {{ 1 }}"
REPLAY = ring_flight()
VOID = {"meta", "br", "link", "img", "input", "hr"}
SECTIONS = [
    "verdicts",
    "next",
    "replay",
    "paper",
    "errors",
    "events",
    "estimates",
    "loop",
    "links",
    "power",
    "reynolds",
    "lyapunov",
    "metrics",
]


class Page(HTMLParser):
    """What a page consists of; fails on a tag that is closed in the wrong place."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html = html
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(" ".join(data.split()))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def text(self) -> str:
        return " ".join(filter(None, self.texts))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """The report of ten minutes of three vehicles at 20 Hz. Its name is a nasty one, and two of its verdicts fail."""
    path = tmp_path_factory.mktemp("report") / "flight.html"
    evidence, _, asked = flown(3, mission=NASTY)
    strict = replace(
        asked, tolerances=TOLERANCES.model_copy(update={"separation_m": 100.0, "radius_error_rms_m": 0.001})
    )
    result = evaluate(evidence.record, strict.ring, strict.formation, strict.tolerances)
    write_report(evidence, result, strict, nasty_flight(NASTY), path)
    return Page(path.read_text(encoding="utf-8"))


def test_ten_minutes_of_three_vehicles_are_small(page: Page) -> None:
    assert len(page.html.encode()) < 3_000_000
    paths: list[str] = re.findall(r' d="([^"]*)"', page.html)
    assert max(path.count("L") + 1 for path in paths) <= 1200


def test_the_parts_come_in_order_and_every_link_finds_its_part(page: Page) -> None:
    assert [each["id"] for each in page.all("section")] == SECTIONS
    assert [each["href"] for each in page.all("a")] == [f"#{name}" for name in SECTIONS[3:]]


def test_nothing_is_fetched_and_nothing_runs_but_the_replay_and_the_charts(page: Page) -> None:
    shown = re.sub(r'<(script type="text/plain"|template) .*?</(script|template)>', "", page.html, flags=re.DOTALL)
    assert len(shown) < len(page.html)
    assert "http" not in shown.replace("<meta http-equiv", "")
    assert [each["type"] for each in page.all("script")] == ["text/plain", "module", "module"]
    assert page.all("iframe") == [{"title": "Replay of the flight", "hidden": None}]
    assert "url(" not in re.sub(r"url\(#\w+\)", "", shown)
    for tag, attributes in page.tags:
        assert tag not in ("link", "img", "object", "embed")
        for name, value in attributes.items():
            assert not name.startswith("on")
            assert name not in ("src", "srcset")
            assert "href" not in name or (value or "").startswith("#")


def test_what_users_name_is_text_and_no_markup(page: Page) -> None:
    assert page.text.count(" ".join(NASTY.split())) >= 3  # title, heading, summary
    assert "<b>/tmp/a&b.mcap</b>" in page.text
    assert "battery <b>low</b>" in page.text
    assert not page.all("b")


def test_names_in_the_replay_do_not_break_out(page: Page) -> None:
    assert page.html.count("<script") == page.html.count("</script>") == 3
    shown = msgspec.json.decode(held_files(page.html)["flight.json"], type=FlightPicture)
    assert shown.mission.mission == NASTY
    assert {each.text for each in shown.events} == {NASTY}


def test_ids_are_unique_and_every_reference_inside_a_chart_has_its_aim(page: Page) -> None:
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r"url\(#(\w+)\)", page.html)) <= set(ids)
    assert {(each["xlink:href"] or "").removeprefix("#") for each in page.all("use")} <= set(ids)


def test_charts_and_tables_can_be_read_out(page: Page) -> None:
    drawn = [each for each in page.all("svg") if each.get("role") == "img"]
    assert len(drawn) == 26
    assert all(len(each["aria-label"] or "") > 20 for each in drawn)
    assert len(page.all("figure")) == len(drawn)
    assert all(each.get("scope") in ("col", "row") for each in page.all("th"))
    assert len(page.all("caption")) == len(page.all("table")) >= 8
    assert page.all("html") == [{"lang": "en"}]
    assert next(tag for tag, _ in page.tags if re.fullmatch(r"h\d", tag)) == "h1"


def test_the_vehicles_keep_the_papers_colours_in_every_key(page: Page) -> None:
    strokes = [each["style"] for each in page.all("path") if each.get("stroke-width") == "3"]
    assert [(each or "")[-8:-1] for each in strokes[:3]] == ["#0077BB", "#CC3311", "#009E73"]
    assert strokes == strokes[:3] * (len(strokes) // 3)


def test_the_verdicts_say_sign_word_and_evidence_beside_the_tolerance() -> None:
    _, result, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    worst_m = max(v.radius_error_rms_m or 0.0 for v in result.vehicles)
    told = {each.name: each for each in verdicts(result, asked)}
    assert list(told) == ["C1", "C2", "C3", "formation", "separation", "engaged", "kept"]
    assert (told["C1"].state.sign, told["C1"].state.value) == ("✓", "passes")
    on_ring = (judged_line(result), "")
    assert told["C1"].evidence == ((f"{worst_m:.3f} m rms", "at most 0.2 m"), on_ring)
    assert on_ring in told["C2"].evidence
    assert on_ring in told["C3"].evidence
    assert told["C2"].evidence[0][1] == "at most 0.002 rad/s"
    assert told["C3"].evidence[0][1] == "at most 2°"
    assert len(told["formation"].evidence) == 2
    assert told["separation"].evidence == ((f"{result.closest_approach_m:.3f} m", "at least 3 m"),)


def test_a_verdict_that_fails_is_told_on_top(page: Page) -> None:
    assert page.text.count("2 of 6 verdicts fail") == 1
    assert page.text.count("✗ fails") == 2
    assert page.text.count("✓ passes") == 4
    assert page.html.index("✗") < page.html.index("<figure>")


def test_the_headline_counts_only_what_applies() -> None:
    _, result, _ = flown(2, duration_s=60.0, rate_hz=5.0)
    for held, words in (
        ((True, True, True, True, True, True, True), "All verdicts pass"),
        ((True, None, None, True, True), "All 3 verdicts that apply pass"),
        ((False, None, None, True, True), "1 of 3 verdicts fails"),
        ((None, None, None, None, None), "No verdict applies"),
    ):
        assert headline(replace(result, verdicts=Verdicts(*held))) == words
    open_ones = replace(result, verdicts=Verdicts(None, None, None, None, True), not_judged=("C1", "C2"))
    assert headline(open_ones) == "2 of 3 verdicts could not be judged"
    failed = replace(open_ones, verdicts=Verdicts(None, None, None, None, False))
    assert headline(failed) == "1 of 3 verdicts fails, 2 could not be judged"


def test_the_summary_tells_the_flight_in_words() -> None:
    _, result, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    told = summary(result, asked).replace("\u00a0", " ")
    assert told.startswith("3 vehicles flew case2 for 120 s ")
    assert "vehicle 1 after 45.0 s, vehicle 2 after 50.0 s and vehicle 3 after 55.0 s." in told
    assert "12 setpoints" in told
    assert "1 failsafe event" in told


def test_of_beliefs_as_good_as_they_say_nearly_all_lie_within_three_sigmas(page: Page) -> None:
    """Gaussian errors of a known spread: 99.7 % within three of it, and their rms over two axes sqrt(2) of it."""
    for sigma_m in (TARGET_SIGMA_M, OWN_SIGMA_M):
        found = re.findall(rf"(\d\.\d+) \d\.\d+ {3.0 * sigma_m:.3f} (\d+\.\d)%", page.text)
        assert len(found) == 3
        for rms_m, share in found:
            assert float(rms_m) == pytest.approx(sigma_m * 2.0**0.5, rel=0.03)
            assert float(share) == pytest.approx(99.73, abs=0.2)


def test_figures_by_truth_have_those_by_estimate_beside_them_in_the_summary() -> None:
    _, result, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    beside = EstimateResult(
        (EstimatedVehicleResult(1, 0.111, 0.2, 0.05, 0.444, 0.5),), RingResult(None, 0.77, 1.0), 1.5
    )
    told = summary(replace(result, estimate=beside), asked).replace("\u00a0", " ")
    of_truth, of_estimate = told.split("estimates", 1)
    assert "truth" in of_truth
    assert "radius 0.111 m rms, spacing 0.77° rms" in of_estimate
    assert "0.444 m rms" in of_estimate
    assert "estimates" not in summary(result, asked)


def test_what_was_not_kept_is_said_in_a_line_instead_of_drawn() -> None:
    evidence, result, asked = flown(3, duration_s=120.0, rate_hz=5.0, engaging=False)
    page = Page(report_html(FlightEvidence(evidence.record, ()), result, asked, REPLAY))
    flight = flight_of(FlightEvidence(evidence.record, ()), result, asked)
    absent = {section.anchor: section.absent for section in sections(flight)}
    assert all(reason in page.text for reasons in absent.values() for reason in reasons)
    for section in ("estimates", "loop", "links", "lyapunov", "power"):
        assert absent[section]
    titles = page.text
    assert "Radius about the target (figure 3, 5), Angular velocity (figure 3, 5)" in titles
    assert len(page.all("figure")) == 10


def turned(evidence: FlightEvidence) -> FlightEvidence:
    """The same, with a first vehicle that turns about itself."""
    first, *others = evidence.vehicles
    turning_rad = (0.1 * first.loop.time_s + np.pi) % (2.0 * np.pi) - np.pi
    return replace(evidence, vehicles=(replace(first, loop=replace(first.loop, yaw_rad=turning_rad)), *others))


def test_no_line_crosses_the_chart_where_a_yaw_wraps() -> None:
    evidence, result, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    axes = Figure().subplots()
    draw_yaws(axes, flight_of(evidence, result, asked).sheet, turned(evidence))
    drawn_deg = axes.lines[0].get_ydata()
    assert np.nanmax(np.abs(np.diff(np.asarray(drawn_deg)))) < 180.0
    assert np.nanmax(drawn_deg) > 170.0


@pytest.mark.parametrize("count", [0, 1])
def test_a_flight_of_hardly_anything_has_a_page(count: int, page: Page) -> None:
    evidence, _, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    few = replace(evidence.record, vehicles=evidence.record.vehicles[:count])
    judged = evaluate(few, asked.ring, asked.formation, asked.tolerances)
    shown = Page(report_html(FlightEvidence(few, turned(evidence).vehicles[:count]), judged, asked, REPLAY))
    assert ("holds no motion" if count == 0 else "One vehicle: ") in shown.text
    assert ["Yaw of the setpoints" in each.text for each in (shown, page)] == [count == 1, False]


def test_without_a_truth_no_error_is_claimed_and_vehicles_never_heard_do_not_break_the_page(
    recwarn: pytest.WarningsRecorder,
) -> None:
    evidence, _, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    first, *others = evidence.record.vehicles
    silent = np.full_like(first.position_m, np.nan)
    mute = replace(first, position_m=silent, velocity_m_s=silent, tactic=np.full(first.tactic.shape, "unknown"))
    record = replace(evidence.record, vehicles=(mute, *others), reference="estimate")
    result = evaluate(record, asked.ring, asked.formation, asked.tolerances)
    by_estimate = replace(result, truth_missing="no truth of vehicle 2 from 4.5 s on")
    page = Page(report_html(replace(evidence, record=record), by_estimate, asked, REPLAY))
    assert "nan" not in page.text.lower().split()
    assert not [each for each in recwarn.list if each.category is RuntimeWarning]
    assert "Own position: " not in page.text
    assert page.text.count("no truth of vehicle 2 from 4.5 s on") == 2  # in the summary and on top
    assert "recorded target" in page.text


def test_a_running_rms_is_that_of_the_samples_behind() -> None:
    values = np.random.default_rng(0).normal(size=(2, 300))
    values[0, 40:60] = np.nan
    found = running_rms(values, 25)
    for row, sample in ((0, 0), (0, 39), (0, 70), (1, 10), (1, 299)):
        behind = values[row, max(0, sample - 24) : sample + 1]
        assert found[row, sample] == pytest.approx(np.sqrt(np.nanmean(behind**2)))
    assert np.isnan(found[0, 40:60]).all()


def test_a_chart_rounds_coordinates_but_no_labels() -> None:
    def draw(axes: object) -> None:
        title(axes, "Heading <i>", "found & kept")  # type: ignore[arg-type]
        axes.plot([0.0, 1.0], [0.12345, 0.98765])  # type: ignore[attr-defined]
        axes.text(0.5, 0.5, "0.123456")  # type: ignore[attr-defined]

    drawn = chart("rounded", draw, 'alt "text"')
    assert (drawn.title, drawn.finding) == ("Heading <i>", "found & kept")
    assert "0.123456" in drawn.svg
    assert 'aria-label="alt &quot;text&quot;"' in drawn.svg
    numbers = re.findall(r"\d+\.(\d+)", " ".join(re.findall(r' d="([^"]*)"', drawn.svg)))
    assert max(map(len, numbers)) == 2
