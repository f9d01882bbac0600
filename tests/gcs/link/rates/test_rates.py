"""The rates of a connection: in what order they go down, what they take, which fit, and how they follow the link."""

from itertools import pairwise

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agents.safety.failsafe import SILENCES_PER_HOUR_MAX
from gcs.autopilots import ardupilot, px4
from gcs.link.rates import (
    ALTITUDE,
    ATTITUDE,
    DEVIATIONS,
    ESTIMATOR_BYTES,
    EXTENDED_SYS_STATE,
    GLOBAL_POSITION_INT,
    LOOK_PERIOD_S,
    SETPOINT_BYTES,
    SLOW_STATUS_BYTES,
    STATUS_BYTES,
    SYS_STATUS,
    TELEMETRY_BYTES,
    UP_AFTER_S,
    Losses,
    RateController,
    Rates,
    Traffic,
    fitting,
    load,
    rate_levels,
)
from sitl.radio import Air, Channel, RadioSpec

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
    assert rate_levels(Rates(4.0, 0.2, 4.0)) == (Rates(4.0, 0.2, 4.0),), "below the least"


@pytest.mark.parametrize(
    ("name", "payload", "size"),
    [
        ("local_position_ned", (1, 1.1, 2.2, 3.3, 4.4, 5.5, 6.6), TELEMETRY_BYTES),
        ("sys_status", (1, 1, 1, 500, 12000, 1, 50, 0, 0, 0, 0, 0, 1), STATUS_BYTES[SYS_STATUS]),
        ("attitude", (1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6), STATUS_BYTES[ATTITUDE]),
        ("extended_sys_state", (0, 1), STATUS_BYTES[EXTENDED_SYS_STATE]),
        ("global_position_int", (1, 1, 1, 1, 1, 1, 1, 1, 30000), SLOW_STATUS_BYTES[GLOBAL_POSITION_INT]),
        ("altitude", (1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1), SLOW_STATUS_BYTES[ALTITUDE]),
        ("estimator_status", (1, 831, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1), ESTIMATOR_BYTES[0]),
        ("sim_state", (0.1,) * 21 + (473977420, 85455940), ardupilot.AUTOPILOT.truth.size_bytes),
        ("hil_state_quaternion", (1, [0.1] * 4, *(0.1,) * 3, *(300,) * 11), px4.AUTOPILOT.truth.size_bytes),
        ("wind_cov", (1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1), ESTIMATOR_BYTES[1]),
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
    assert total.down_bytes_s == 3 * (400.0 + 97.0 + 187.0 + 21.0 + 14.0)
    signed = load(Rates(telemetry_hz=10.0, status_hz=1.0, setpoint_hz=10.0), 3, signed=True)
    assert signed.up_bytes_s == 3 * 780.0 + 34.0 + 20.5


def test_rates_that_fit_leave_a_reserve_and_the_next_higher_do_not() -> None:
    levels = rate_levels(FULL)
    index = fitting(levels, 3, 3840.0)
    assert load(levels[index], 3).bytes_s <= 0.7 * 3840.0 < load(levels[index - 1], 3).bytes_s
    assert fitting(levels, 3, 100.0) == len(levels) - 1
    assert fitting(levels, 1, 1e6) == 0


class Line:
    """A connection whose counts are made up: of 100 frames between two looks `missed` do not arrive."""

    def __init__(self, pace: RateController) -> None:
        self.pace, self.now_s = pace, 0.0
        self._count = Traffic()

    def looks(
        self, count: int, missed: int = 0, bursts: int = 0, free: float | None = None, late_s: float = 0.0
    ) -> Rates:
        for _ in range(count):
            self.now_s += LOOK_PERIOD_S
            self._count = Traffic(
                received=self._count.received + 100 - missed,
                missed=self._count.missed + missed,
                bursts=self._count.bursts + bursts,
                buffer_free=free,
                delay_grown_s=late_s,
            )
            self.pace.look(self._count, self.now_s)
        return self.pace.rates


def of_emulated_channel(spec: RadioSpec, frames_hz: float, duration_s: float) -> tuple[Losses, list[float]]:
    """Send frames evenly through an emulated radio; return what is lost, and when the others arrive."""
    channel, arrived_s, frames = Channel(spec, Air(None), (1,)), list[float](), round(duration_s * frames_hz)
    burst = bursts = 0
    for number in range(frames):
        channel.send(b"", number / frames_hz)
        arrives = bool(channel.arrived(number / frames_hz))
        if arrives:
            arrived_s.append(number / frames_hz)
        bursts += burst > 0 and arrives
        burst = 0 if arrives else burst + 1
    return Losses(frames, frames - len(arrived_s), bursts), arrived_s


@pytest.mark.parametrize(("loss", "burst", "frames_hz"), [(0.1, 6.0, 10.0), (0.05, 3.0, 5.0)])
def test_silences_are_as_often_as_the_formula_says(loss: float, burst: float, frames_hz: float) -> None:
    losses, arrived_s = of_emulated_channel(RadioSpec(loss=loss, burst=burst), frames_hz, 4 * 3600.0)
    assert (losses.share, losses.burst) == pytest.approx((loss, burst), rel=0.1)
    silences = sum(later - earlier >= 1.0 - 1e-6 for earlier, later in pairwise(arrived_s)) / 4.0
    assert silences > 50
    assert losses.silences_per_hour(frames_hz, 1.0) == pytest.approx(silences, rel=0.2)


def test_the_length_of_bursts_is_known_as_well_as_is_said() -> None:
    bursts, drawn = 12, np.random.default_rng(1).geometric(1.0 / 4.0, (400, 12)).sum(axis=1)
    counted = [Losses(1000.0, float(lost), bursts) for lost in drawn]
    within = [losses.longer(-DEVIATIONS).burst <= 4.0 <= losses.longer(DEVIATIONS).burst for losses in counted]
    assert 0.92 <= np.mean(within) <= 0.98
    assert {losses.longer(DEVIATIONS).share for losses in counted} == {losses.share for losses in counted}
    assert Losses(1000.0, 3.0, 3.0).longer(-9.0).burst == 1.0
    assert Losses(1000.0, 3.0, 3.0).longer(9.0).burst == 6.0, "all of them, and three more"


@pytest.mark.parametrize(("baud", "vehicles"), [(38400, 1), (115200, 3)])
def test_a_line_with_bursts_of_three_has_few_silent_seconds(baud: int, vehicles: int) -> None:
    pace = RateController(FULL, vehicles, baud / 10.0, automatic=True, telemetry_s=1.0, offboard_s=1.0)
    rates = Line(pace).looks(60, missed=5, bursts=2)
    losses = Losses(1e6, 5e4, 2e4)
    assert losses.silences_per_hour(rates.setpoint_hz, 1.0) < SILENCES_PER_HOUR_MAX
    assert losses.silences_per_hour(rates.telemetry_hz, 1.0) < SILENCES_PER_HOUR_MAX
    assert load(rates, vehicles).bytes_s <= 0.9 * baud / 10.0


def test_bursts_raise_the_rates_above_those_of_the_mission_and_their_end_lowers_them() -> None:
    pace = RateController(FULL, 1, 11520.0, automatic=True, telemetry_s=1.0, offboard_s=1.0)
    line = Line(pace)
    raised = line.looks(60, missed=5, bursts=1)
    assert raised.setpoint_hz > FULL.setpoint_hz
    assert raised.telemetry_hz > FULL.telemetry_hz
    assert (pace.copies - 1) * FULL.setpoint_hz < raised.setpoint_hz <= pace.copies * FULL.setpoint_hz
    assert line.looks(200) == FULL
    assert pace.copies == 1
    steady = RateController(FULL, 1, automatic=True)
    assert Line(steady).looks(200, missed=20, bursts=20) == FULL, "single losses, whatever the load"


def test_where_not_all_fits_motion_and_setpoints_go_below_what_losses_require_together() -> None:
    pace = RateController(FULL, 1, 1920.0, automatic=True, telemetry_s=1.0, offboard_s=1.0)
    rates = Line(pace).looks(60, missed=10, bursts=2)
    assert load(rates, 1).bytes_s <= 0.9 * 1920.0
    assert rates.telemetry_hz == pytest.approx(rates.setpoint_hz, rel=0.3)
    assert pace.silences_per_hour > SILENCES_PER_HOUR_MAX
    assert "silences an hour" in pace.fault


@pytest.mark.parametrize(("free", "late_s"), [(0.1, 0.0), (None, 0.7)])
def test_messages_that_wait_lower_the_rates_and_a_quiet_time_raises_them_no_higher_than_where_they_began(
    free: float | None, late_s: float
) -> None:
    pace = RateController(FULL, 1, automatic=True)
    line, levels = Line(pace), rate_levels(FULL)
    assert line.looks(1) == FULL
    assert line.looks(3, free=free, late_s=late_s) == levels[3]
    assert line.looks(5, free=0.4) == levels[3]  # neither well nor bad
    assert line.looks(int(UP_AFTER_S / LOOK_PERIOD_S)) == levels[2]
    assert line.looks(100) == FULL
    assert line.looks(50, free=free, late_s=late_s) == levels[-1]


def test_few_frames_show_no_losses() -> None:
    pace = RateController(FULL, 1, automatic=True)
    for second in range(0, 20, 2):
        pace.look(Traffic(received=second, missed=second * 3, bursts=second), float(second))
    assert (pace.rates, pace.fault) == (FULL, "")


def test_what_the_connection_lacks_is_stated_until_it_has_been_well_for_a_while() -> None:
    pace = RateController(FULL, 3, 3840.0)
    line = Line(pace)
    assert line.looks(60, missed=33, bursts=11, free=0.0) == FULL
    assert "33% of its messages are lost, 3.0 in a row" in pace.fault
    assert "buffer" in pace.fault
    line.looks(60, missed=8, bursts=8)
    assert pace.fault  # neither well nor bad
    line.looks(60)
    assert not pace.fault


def test_losses_that_come_and_go_are_one_fault() -> None:
    pace = RateController(FULL, 1)
    line, stated = Line(pace), list[bool]()
    for _ in range(100):
        for missed in (18, 4):
            line.looks(1, missed=missed, bursts=missed)
            stated.append(bool(pace.fault))
    assert stated == sorted(stated)
    assert stated[-1]


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
