"""Keys of earlier versions: each is a fault that names the present key, or the value that became a constant."""

import pytest

from tests.support.mission_text import content, faults, put


@pytest.mark.parametrize(
    ("path", "states"),
    [
        (("vehicles", 0, "plant"), "profile"),
        (("target_filter", "coast_s"), "[target] and [tuning.target_filter]"),
        (("encirclement", "radius_min_m"), "tuning.encirclement.radius_min_m"),
        (("tuning", "failsafe", "clock_step_s"), "always 0.5"),
        (("mission", "format"), "it must be 2 (given: 1)"),
    ],
)
def test_a_former_key_is_a_fault_that_names_the_present_one(path: tuple[str | int, ...], states: str) -> None:
    (fault,) = faults(put(content(), path, 1))
    place = "vehicles[0].plant" if path[0] == "vehicles" else ".".join(map(str, path))
    assert place.startswith(fault.partition(":")[0])
    assert states in fault
