"""The diagram of the tactics, the decision rule at its thresholds, and the mixing of tactics."""

from math import pi

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.settings.sections import DecisionSettings
from agents.tactics import TRANSITIONS, Event, decides_to_encircle, mixing_share
from estimation.state import TargetEstimate
from tests.support.diagrams import tactic_diagram
from tests.support.estimates import target_spread


def test_an_event_of_an_earlier_log_is_known_by_its_former_name() -> None:
    assert Event("pilot took over") is Event.HANDED_OVER
    with pytest.raises(ValueError, match="nothing of that kind"):
        Event("nothing of that kind")


def test_the_diagram_shows_every_transition_and_no_other() -> None:
    first, *arrows = [line.strip() for line in tactic_diagram().splitlines()]
    assert first == "stateDiagram-v2"
    shown = [f"{before.value} --> {after.value}: {event.value}" for (before, event), after in TRANSITIONS.items()]
    assert sorted(arrows) == sorted(["[*] --> standby", "land --> [*]", *shown])


THRESHOLDS = DecisionSettings(importance_min=0.6, threat_max=0.5, distance_max_m=12.0)


@given(
    st.sampled_from([0.0, 0.6, 0.61, 1.0]) | st.floats(0.0, 1.0),
    st.sampled_from([0.0, 0.49, 0.5, 1.0]) | st.floats(0.0, 1.0),
    st.sampled_from([0.0, 11.99, 12.01]) | st.floats(0.0, 100.0),
    st.floats(-pi, pi),
)
def test_the_decision_at_its_thresholds(importance: float, threat: float, distance: float, bearing: float) -> None:
    assume(abs(distance - 12.0) > 1e-6)
    position = np.array([35.0, -5.0])
    place = position + distance * np.array([np.cos(bearing), np.sin(bearing)])
    target = TargetEstimate(0.0, np.array([*place, 9.0, 9.0]), target_spread(1.0), 0.0, importance, threat)
    engages = importance > 0.6 and threat < 0.5 and distance < 12.0
    assert decides_to_encircle(target, position, THRESHOLDS) is engages


@given(st.floats(-10.0, 20.0), st.floats(0.01, 10.0))
def test_the_share_rises_from_none_to_all(since_s: float, smoothing_s: float) -> None:
    share = mixing_share(since_s, smoothing_s)
    assert 0.0 <= share <= 1.0
    assert share == (0.0 if since_s <= 0.0 else 1.0) or 0.0 < since_s < smoothing_s
    assert mixing_share(since_s + 0.1, smoothing_s) >= share
    assert share + mixing_share(smoothing_s - since_s, smoothing_s) == pytest.approx(1.0)
