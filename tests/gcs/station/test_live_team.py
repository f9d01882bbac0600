"""Time for which nothing could come from a team: its simulated clock stood still, or the station was not run."""

from math import inf

import pytest

from gcs.link.ports import free_ports
from gcs.station.live_team import Standstill
from sitl.server.shared_clock import Rank, Seat, new_clock


def test_without_a_simulated_clock_only_times_without_looks_count() -> None:
    standstill = Standstill(free_ports(2))
    for now_s in (10.0, 10.1, 10.2):
        standstill.look(now_s)
    assert standstill.duration_s == 0.0
    standstill.look(15.2)
    assert standstill.duration_s == pytest.approx(4.5)
    standstill.end()
    assert standstill.duration_s == 0.0


def test_the_time_of_stubs_that_stands_still_counts_while_their_program_runs() -> None:
    ports = free_ports(2)
    standstill = Standstill(ports[:1])
    with new_clock(inf, ports) as name, Seat(name, Rank.STUBS) as stubs:
        standstill.look(10.0)
        stubs.wait_until(300_000)
        standstill.look(10.1)
        assert standstill.duration_s == 0.0, "it runs three times as fast as the wall's"
        stubs.wait_until(340_000)
        standstill.look(10.2)
        assert standstill.duration_s == pytest.approx(0.06)
        for now_s in (10.3, 10.4):
            standstill.look(now_s)
        assert standstill.duration_s == pytest.approx(0.26)
    standstill.look(10.5)
    standstill.look(10.6)
    assert standstill.duration_s == pytest.approx(0.26), "their program has ended: silence counts again"
