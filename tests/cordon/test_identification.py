"""Plants identified by cordon's function, from logs that its tests have of real programs."""

from pathlib import Path

import numpy as np
import pytest

import cordon
from tests.support.paths import DATA


def test_the_true_plant_lies_within_the_intervals() -> None:
    """A stub's plant is known: tests/data/README.md."""
    with pytest.warns(UserWarning, match="records are missing"):  # fast topics are left out of it
        identified = cordon.identify(DATA / "stub-excitation.mcap")
    found = identified.found
    assert found is not None
    stub = cordon.load("case2").vehicle(1).plant
    for axis, true in zip(found.axes, (stub.x, stub.y), strict=True):
        assert axis.a0_per_s2.low < true.a0_per_s2 < axis.a0_per_s2.high
        assert axis.a1_per_s.low < true.a1_per_s < axis.a1_per_s.high
        assert (axis.a0_per_s2.value, axis.a1_per_s.value) == pytest.approx((true.a0_per_s2, true.a1_per_s), rel=0.01)
    assert found.delay_s.value < 0.03, "links and the loop need some milliseconds; the stub's plant has no delay"
    assert found.plant.x.a0_per_s2 == found.axes[0].a0_per_s2.value


def test_an_identification_is_drawn_with_and_without_a_file(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="records are missing"):
        identified = cordon.identify(DATA / "stub-excitation.mcap")
    assert identified.found is not None
    figure = identified.plot(tmp_path / "fit.svg")
    assert b"<svg" in (tmp_path / "fit.svg").read_bytes()
    titles = [panel.get_title(loc=side) for panel in figure.axes for side in ("left", "right")]
    assert {"Along x, north", "Step along y, west", "Errors along x, north"} <= {*titles}
    assert f"fit {identified.found.axes[1].fit_percent:.1f} %" in titles
    # The step response is drawn from the plant that was found: it begins after the delay, and ends at the setpoint.
    response = np.asarray(figure.axes[2].lines[0].get_ydata())
    assert (response[0], response[-1]) == pytest.approx((0.0, 1.0), abs=0.02)
    with pytest.raises(cordon.InputError, match=r"plot: .*fit\.xyz"):
        identified.plot(tmp_path / "fit.xyz")


def test_the_vehicle_has_to_be_told_where_logs_hold_several(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    cordon.simulate("case1", duration_s=2.0, log=log)
    with pytest.raises(cordon.InputError, match=r"^vehicle: .*1, 2, 3"):
        cordon.identify(log)
    unidentified = cordon.identify(log, vehicle=2)
    assert unidentified.found is None, "two seconds tell nothing"
    with pytest.raises(cordon.InputError, match=r"plot: .*no plant"):
        unidentified.plot()
    with pytest.raises(cordon.InputError, match="more than once"):
        cordon.identify(log, log, vehicle=2)
