"""The profiles that come with cordon are what `cordon identify` finds in logs that lie beside these tests."""

from hashlib import sha256
from pathlib import Path

import pytest

from estimation.identification.identify import identify
from estimation.profile.profile import ProfileLibrary
from gcs.autopilots.registry import autopilot_of
from gcs.identify.reading import recording_of
from gcs.identify.view import limits_in
from gcs.vehicle_logs.foreign import read_vehicle_logs
from tests.experiments.identification_draws import intervals_of
from tests.support.paths import DATA, PROFILES

pytestmark = pytest.mark.slow

LOGS = {"px4": "px4-quad-excitation.ulg", "ardupilot": "arducopter-excitation.bin", "stub": "stub-excitation.mcap"}


def test_profiles_name_their_logs() -> None:
    for name, log in LOGS.items():
        digest = sha256((DATA / log).read_bytes()).hexdigest()
        assert digest in (PROFILES / f"{name}.toml").read_text(encoding="utf-8"), name


def test_a_profile_equals_the_identification_of_its_log() -> None:
    """Also PX4's: `tests/gcs/cli/test_identify_command.py`; the stub's: `tests/cordon/test_identification.py`."""
    profile, [log] = ProfileLibrary(Path()).load("ardupilot"), read_vehicle_logs(DATA / LOGS["ardupilot"])
    found, plant, filtered = identify([recording_of(log)]).found, profile.plant, profile.own_filter
    assert found is not None
    numbers = plant.x.a0_per_s2, plant.x.a1_per_s, plant.y.a0_per_s2, plant.y.a1_per_s, plant.delay_s
    assert numbers == pytest.approx([each.value for each in intervals_of(found)], rel=2e-3)
    values = [getattr(found.noise, key) for key in filtered.model_fields_set]
    assert [getattr(filtered, key) for key in filtered.model_fields_set] == pytest.approx(values, rel=1e-2)
    assert len(values) == 4
    limits, parameters = limits_in([log], autopilot_of("ardupilot"))
    assert (profile.limits, len(parameters)) == (limits, 2)
