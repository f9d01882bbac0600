"""The rows of the live view of a flight."""

import pytest

from agents.outputs import CoreStatus
from agents.tactics import Tactic
from gcs.flight.watch import _ring


@pytest.mark.parametrize("tactic", Tactic)
def test_a_vehicle_is_shown_on_a_ring_only_while_it_flies_there(tactic: Tactic) -> None:
    status = CoreStatus(vehicle_id=1, time_s=1.0, tactic=tactic, ring=1)
    assert _ring(status, ("north", "south")) == ("south" if tactic.value in ("encircle", "transit") else "")
    assert _ring(None, ("north", "south")) == ""
