"""Plants identified by cordon's function, from logs that its tests have of real programs."""

from pathlib import Path

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


def test_the_vehicle_has_to_be_told_where_logs_hold_several(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    cordon.simulate("case1", duration_s=2.0, log=log)
    with pytest.raises(cordon.InputError, match=r"^vehicle: .*1, 2, 3"):
        cordon.identify(log)
    assert cordon.identify(log, vehicle=2).found is None, "two seconds tell nothing"
    with pytest.raises(cordon.InputError, match="more than once"):
        cordon.identify(log, log, vehicle=2)
