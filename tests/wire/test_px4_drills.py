"""The drills on PX4, where CORDON_PX4 names a simulator: see `tests.experiments.px4_drills`.

They take PX4's own ports.
"""

import pytest

from gcs.drill.run import DrillRun
from tests.experiments.px4_drills import DRILLS, FLIGHTS, MISSION, STOOD_DOWN_MAX_S, fly, stood_down_after_s
from tests.support.drills import Silent
from tests.support.px4 import Px4Missing, px4_build


@pytest.mark.px4
@pytest.mark.timeout(3600)
async def test_every_drill_holds_on_px4() -> None:
    try:
        px4_build()
    except Px4Missing as missing:
        pytest.skip(str(missing))
    rows = await DrillRun(MISSION, fly, DRILLS, Silent(), speed=1.0).run()
    assert [row.fault for row in rows] == [drill.fault for drill in DRILLS]
    assert [row for row in rows if row.holds is not True] == []
    told = [after_s for flight in FLIGHTS for after_s in stood_down_after_s(flight).values()]
    assert told
    assert max(told) <= STOOD_DOWN_MAX_S
