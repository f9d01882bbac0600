"""Keys of earlier versions: each is a fault that names the present key, or the value that became a constant."""

import pytest

from agents.ring.transition import ACCELERATION_MAX_M_S2
from gcs.mission.sections import TUNING
from gcs.mission.validation import FORMER_KEYS
from tests.support.mission_text import content, faults, put


@pytest.mark.parametrize(
    ("path", "states"),
    [
        (("vehicles", 0, "plant"), "profile"),
        (("own_filter", "gate_sigma"), "[own_filter] of the vehicles' profiles"),
        (("target_filter", "coast_s"), "[target] and [tuning.target_filter]"),
        (("encirclement", "radius_min_m"), "tuning.encirclement.radius_min_m"),
        (("encirclement", "spacing_acceleration_max_m_s2"), f"always {ACCELERATION_MAX_M_S2:g}"),
        (("tuning", "failsafe", "clock_step_s"), "always 0.5"),
        (("mission", "format"), "it must be 2 (given: 1)"),
    ],
)
def test_a_former_key_is_a_fault_that_names_the_present_one(path: tuple[str | int, ...], states: str) -> None:
    (fault,) = faults(put(content(), path, 1))
    place = "vehicles[0].plant" if path[0] == "vehicles" else ".".join(map(str, path))
    assert place.startswith(fault.partition(":")[0])
    assert states in fault


def test_every_tuning_key_is_named_where_it_was() -> None:
    mission = content()
    former = [(name, key) for name, model in TUNING.items() for key in model.model_fields if name != "target_filter"]
    for name, key in former:
        mission = put(mission, (name, key), 1.0)
    told = "\n".join(faults(mission))
    assert all(FORMER_KEYS[f"{name}.{key}"] in told for name, key in former)
