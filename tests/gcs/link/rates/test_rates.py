"""The rates of a connection: in what order they go down, what they take, which fit, and how they follow the link."""

from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs.autopilots import ardupilot, px4
from gcs.link.rates import (
    LOOK_PERIOD_S,
    SETPOINT_BYTES,
    SLOW_STATUS_BYTES,
    STATUS_BYTES,
    TELEMETRY_BYTES,
    UP_AFTER_S,
    RateController,
    Rates,
    Traffic,
    fitting,
    load,
    rate_levels,
)

FULL = Rates(telemetry_hz=20.0, status_hz=2.0, setpoint_hz=20.0)


def test_status_goes_down_first_then_motion_then_setpoints_and_each_to_its_least() -> None:
    levels = rate_levels(FULL)
    changed = [
        [name for name in ("status_hz", "telemetry_hz", "setpoint_hz") if getattr(low, name) < getattr(high, name)]
        for high, low in pairwise(levels)
    ]
    assert changed == [["status_hz"]] * 2 + [["telemetry_hz"]] * 5 + [["setpoint_hz"]] * 5
    assert levels[0] == FULL
    assert levels[-1] == Rates(telemetry_hz=5.0, status_hz=0.5, setpoint_hz=5.0)


def test_a_rate_below_the_least_stays() -> None:
    assert rate_levels(Rates(4.0, 0.2, 4.0)) == (Rates(4.0, 0.2, 4.0),)


@pytest.mark.parametrize(
    ("name", "payload", "size"),
    [
        ("local_position_ned", (1, 1.1, 2.2, 3.3, 4.4, 5.5, 6.6), TELEMETRY_BYTES),
        ("sys_status", (1, 1, 1, 500, 12000, 1, 50, 0, 0, 0, 0, 0, 1), STATUS_BYTES[0]),
        ("attitude", (1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6), STATUS_BYTES[1]),
        ("extended_sys_state", (0, 1), STATUS_BYTES[2]),
        ("global_position_int", (1, 1, 1, 1, 1, 1, 1, 1, 30000), SLOW_STATUS_BYTES[3]),
        ("estimator_status", (1, 831, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1), SLOW_STATUS_BYTES[4]),
        ("sim_state", (0.1,) * 21 + (473977420, 85455940), ardupilot.AUTOPILOT.truth.size_bytes),
        ("hil_state_quaternion", (1, [0.1] * 4, *(0.1,) * 3, *(300,) * 11), px4.AUTOPILOT.truth.size_bytes),
        ("wind_cov", (1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1), SLOW_STATUS_BYTES[5]),
        (
            "set_position_target_local_ned",
            (1, 1, 1, 1, 0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0),
            SETPOINT_BYTES,
        ),
    ],
)
def test_messages_are_as_long_as_the_dialect_says(name: str, payload: tuple[float, ...], size: int) -> None:
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    assert len(getattr(sender, f"{name}_encode")(*payload).pack(sender)) == size


def test_the_load_of_three_vehicles_adds_up_by_hand() -> None:
    total = load(Rates(telemetry_hz=10.0, status_hz=1.0, setpoint_hz=10.0), 3)
    assert total.up_bytes_s == 3 * 650.0 + 21.0 + 14.0
    assert total.down_bytes_s == 3 * (400.0 + 97.0 + 165.0 + 21.0 + 14.0)
    signed = load(Rates(telemetry_hz=10.0, status_hz=1.0, setpoint_hz=10.0), 3, signed=True)
    assert signed.up_bytes_s == 3 * 780.0 + 34.0 + 20.5


def test_rates_that_fit_leave_a_reserve_and_the_next_higher_do_not() -> None:
    levels = rate_levels(FULL)
    index = fitting(levels, 3, 3840.0)
    assert load(levels[index], 3).bytes_s <= 0.7 * 3840.0 < load(levels[index - 1], 3).bytes_s
    assert fitting(levels, 3, 100.0) == len(levels) - 1
    assert fitting(levels, 1, 1e6) == 0


class Line:
    """A connection whose counts are made up: 100 frames arrive between two looks, `missed` do not."""

    def __init__(self, pace: RateController) -> None:
        self.pace, self.now_s = pace, 0.0
        self._received = self._missed = 0

    def looks(self, count: int, missed: int = 0, free: float | None = None) -> Rates:
        for _ in range(count):
            self._received, self._missed, self.now_s = self._received + 100, self._missed + missed, self.now_s + 2.0
            self.pace.look(Traffic(0, 0, self._received, self._missed, free), self.now_s)
        return self.pace.rates


def test_losses_lower_the_rates_and_a_quiet_time_raises_them_no_higher_than_where_they_began() -> None:
    pace = RateController(FULL, 1, automatic=True)
    line, levels = Line(pace), rate_levels(FULL)
    assert line.looks(1) == FULL
    assert line.looks(3, missed=20) == levels[3]
    assert line.looks(5, missed=7) == levels[3]  # neither well nor bad
    assert line.looks(int(UP_AFTER_S / LOOK_PERIOD_S)) == levels[2]
    assert line.looks(100) == FULL


def test_a_full_radio_lowers_the_rates_to_the_last_and_no_further() -> None:
    pace = RateController(FULL, 1, automatic=True)
    assert Line(pace).looks(50, free=0.1) == rate_levels(FULL)[-1]


def test_few_frames_show_no_losses() -> None:
    pace = RateController(FULL, 1, automatic=True)
    for second in range(0, 20, 2):
        pace.look(Traffic(received=second, missed=second * 3, buffer_free=None), float(second))
    assert pace.rates == FULL


def test_fixed_rates_stay_and_what_the_connection_lacks_is_stated_until_it_is_well() -> None:
    pace = RateController(FULL, 3, 3840.0)
    line = Line(pace)
    assert line.looks(20, missed=50, free=0.0) == FULL
    assert "33%" in pace.fault  # 50 of 150
    line.looks(1, missed=7)
    assert pace.fault  # neither well nor bad
    line.looks(1)
    assert not pace.fault
    line.looks(1, free=0.1)
    assert "buffer" in pace.fault


def test_simulators_are_asked_for_the_truth_where_there_is_room() -> None:
    small, large = (RateController(FULL, 3, baud / 10.0, truth_bytes_s=2280.0) for baud in (115200, 921600))
    assert small.truth_bytes_s == 0.0
    assert small.load == load(FULL, 3)
    assert large.truth_bytes_s == 2280.0
    assert large.load.down_bytes_s == load(FULL, 3).down_bytes_s + 2280.0
    assert RateController(FULL, 3, truth_bytes_s=2280.0).truth_bytes_s == 2280.0


def test_what_may_be_sent_leaves_the_vehicles_their_room() -> None:
    pace = RateController(FULL, 3, 5760.0, automatic=True)
    assert pace.up_bytes_s == pytest.approx(5760.0 - pace.load.down_bytes_s)
    too_much = RateController(FULL, 3, 3840.0)
    assert too_much.up_bytes_s == pytest.approx(too_much.load.up_bytes_s)
    assert RateController(FULL, 3).up_bytes_s is None
