"""The profiles that come with cordon are what `cordon identify` finds in logs that lie beside these tests."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import pytest

from estimation.identification.identified import ParameterEstimate
from estimation.identification.identify import identify
from estimation.profile.profile import Profile, ProfileLibrary
from gcs.autopilots.registry import autopilot_of
from gcs.identify.reading import recording_of
from gcs.identify.view import limits_in
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog
from tests.experiments.identification_draws import intervals_of
from tests.support.paths import DATA, PROFILES

pytestmark = pytest.mark.slow

LOGS = {"px4": "px4-quad-excitation.ulg", "ardupilot": "arducopter-excitation.bin", "stub": "stub-excitation.mcap"}


@dataclass(frozen=True)
class Bundled:
    """A bundled profile, and what its log says today."""

    profile: Profile
    found: ParameterEstimate
    log: VehicleLog

    @property
    def numbers(self) -> tuple[float, ...]:
        plant = self.profile.plant
        return plant.x.a0_per_s2, plant.x.a1_per_s, plant.y.a0_per_s2, plant.y.a1_per_s, plant.delay_s


def bundled(name: str) -> Bundled:
    file = ProfileLibrary(Path()).load(name)
    [log] = read_vehicle_logs(DATA / LOGS[name])
    found = identify([recording_of(log)]).found
    assert found is not None
    return Bundled(file, found, log)


def test_profiles_name_their_logs() -> None:
    for name, log in LOGS.items():
        digest = sha256((DATA / log).read_bytes()).hexdigest()
        assert digest in (PROFILES / f"{name}.toml").read_text(encoding="utf-8"), name


def test_a_profile_equals_the_identification_of_its_log() -> None:
    """Also PX4's: `tests/gcs/cli/test_identify_command.py`."""
    here = bundled("ardupilot")
    assert here.numbers == pytest.approx([each.value for each in intervals_of(here.found)], rel=2e-3)
    noise, filtered = here.found.noise, here.profile.own_filter
    assert noise is not None
    values = [getattr(noise, key) for key in filtered.model_fields_set]
    assert [getattr(filtered, key) for key in filtered.model_fields_set] == pytest.approx(values, rel=1e-2)
    assert len(values) == 4
    limits, parameters = limits_in([here.log], autopilot_of("ardupilot"))
    assert (here.profile.limits, len(parameters)) == (limits, 2)


def test_the_stub_is_identified_as_what_it_is() -> None:
    here = bundled("stub")
    *intervals, delay_s = intervals_of(here.found)
    assert [(each.low <= value <= each.high) for each, value in zip(intervals, here.numbers, strict=False)] == [
        True
    ] * 4
    assert [each.value for each in intervals] == pytest.approx(here.numbers[:4], rel=0.01)
    assert delay_s.value < 0.03, "links and the loop need some milliseconds; the stub's plant has no delay"
