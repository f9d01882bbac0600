"""The report of others' logs: distances known from the motion, and a page that says what there is and is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gcs.cli.report import ReportOptions, report
from gcs.errors import Exit
from gcs.report.vehicle_page import distance_m, summarised, vehicle_report_html
from gcs.vehicle_logs.vehicle_log import ModeSegment, Series, Span, VehicleLog
from tests.gcs.report.test_page import Page
from tests.support.paths import DATA

TIME_S = np.arange(0.0, 20.0, 0.1)
LAG_M = 0.5


def moving() -> VehicleLog:
    """Return the log of a vehicle that flies half a metre behind its setpoint, in offboard from 5 to 15 s."""
    ahead = np.column_stack([0.7 * TIME_S, 2.0 - 0.7 * TIME_S, np.full(TIME_S.size, 8.0)])
    behind = ahead - [LAG_M * np.sqrt(0.5), -LAG_M * np.sqrt(0.5), 0.0]
    xyz = ("x", "y", "z")
    return VehicleLog(
        path="a<b>.ulg",
        format="PX4 log (.ulg)",
        sha256="0" * 64,
        autopilot="px4",
        firmware="v1",
        system_id=7,
        duration_s=20.0,
        setpoint=Series("setpoints", xyz, TIME_S, ahead),
        position=Series("positions", xyz, TIME_S, behind),
        modes=tuple(
            ModeSegment(Span(begin_s, end_s), name, external)
            for begin_s, end_s, name, external in (
                (0, 5, "hold", False),
                (5, 15, "offboard", True),
                (15, 20, "land", False),
            )
        ),
    )


def test_the_distance_is_that_to_the_setpoint_that_holds_while_a_computer_flies() -> None:
    time_s, apart_m = distance_m(moving())
    flown = (time_s >= 5.0) & (time_s < 15.0)
    assert apart_m[flown] == pytest.approx(LAG_M, abs=1e-9)
    assert np.isnan(apart_m[~flown]).all()
    assert summarised(moving())["setpoint_distance_rms_m"] == pytest.approx(LAG_M)


def test_between_sparse_setpoints_the_last_one_holds() -> None:
    log = moving()
    assert log.setpoint is not None
    sparse = Series("setpoints", log.setpoint.columns, TIME_S[::10], log.setpoint.values[::10])
    time_s, apart_m = distance_m(replace(log, setpoint=sparse))
    # A second later the vehicle has come up to the old setpoint, at 0.7 m/s along each axis, and flown past it.
    passed_m = 0.9 * 0.7 * np.sqrt(2.0) - LAG_M
    assert apart_m[np.isclose(time_s, 8.9)] == pytest.approx(passed_m, abs=1e-9)


def test_the_page_escapes_names_and_needs_nothing_from_elsewhere() -> None:
    page = Page(vehicle_report_html([moving()]))
    assert "a<b>.ulg" in page.text
    assert page.all("b") == page.all("script") == []
    assert not [each for _, named in page.tags for key in ("src", "href") if "//" in (each := named.get(key) or "")]
    for heading in ("Setpoint and position", "Distance from the setpoint", "Flight modes"):
        assert heading in page.text


def test_a_log_without_a_position_says_so() -> None:
    page = Page(vehicle_report_html([replace(moving(), position=None, missing=("vehicle_local_position",))]))
    assert "holds no position" in page.text
    assert "no vehicle_local_position in it" in page.text


@pytest.mark.parametrize("name", ["px4-quad.ulg", "arducopter.bin"])
def test_recorded_logs_are_reported(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    assert report([DATA / name], options=ReportOptions(json=True, html=page)) is Exit.HOLDS
    out = capsys.readouterr().out
    assert out.startswith('{"format": 1, "logs": [{"path": ')
    assert 0.02e6 < page.stat().st_size < 0.5e6
