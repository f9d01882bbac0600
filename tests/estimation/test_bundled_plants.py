"""The plants that come with cordon are what `cordon identify` finds in logs that lie beside these tests."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from estimation.identification.identified import Found
from estimation.identification.identify import identify
from estimation.plant.model import Plant
from estimation.profile.shelf import ProfileShelf
from gcs.identify.reading import recording_of
from gcs.vehicle_logs.foreign import read_vehicle_logs
from tests.experiments.identification_draws import intervals_of
from tests.support.paths import DATA, PROFILES

LOGS = {"px4": "px4-quad-excitation.ulg", "ardupilot": "arducopter-excitation.bin", "stub": "stub-excitation.mcap"}


@dataclass(frozen=True)
class Bundled:
    """A bundled plant, and what its log says today."""

    plant: Plant
    found: Found

    @property
    def numbers(self) -> tuple[float, ...]:
        x, y = self.plant.x, self.plant.y
        return x.a0_per_s2, x.a1_per_s, y.a0_per_s2, y.a1_per_s, self.plant.delay_s


def bundled(name: str) -> Bundled:
    file = ProfileShelf(Path()).load(name)
    [log] = read_vehicle_logs(DATA / LOGS[name])
    found = identify([recording_of(log)]).found
    assert found is not None
    assert log.sha256 in (PROFILES / f"{name}.toml").read_text(encoding="utf-8"), "the profile names another log"
    return Bundled(file.plant, found)


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_a_plant_is_what_its_log_says(name: str) -> None:
    here = bundled(name)
    assert here.numbers == pytest.approx([each.value for each in intervals_of(here.found)], rel=2e-3)


def test_the_stub_is_identified_as_what_it_is() -> None:
    here = bundled("stub")
    *intervals, delay_s = intervals_of(here.found)
    assert [(each.low <= value <= each.high) for each, value in zip(intervals, here.numbers, strict=False)] == [
        True
    ] * 4
    assert [each.value for each in intervals] == pytest.approx(here.numbers[:4], rel=0.01)
    assert delay_s.value < 0.03, "links and the loop need some milliseconds; the stub's plant has no delay"
