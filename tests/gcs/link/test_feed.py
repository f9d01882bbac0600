"""Heights and places as a vehicle sends them, compared with its other sensors and with what it can fly."""

from collections.abc import Callable
from math import nan
from types import SimpleNamespace
from typing import Any

import pytest
from mavsdk.autopilot import Autopilot
from mavsdk.plugins.telemetry import FixType
from pymavlink.dialects.v20 import common

from estimation.frames import Geodetic, MissionFrame
from gcs.link import feed as feed_module
from gcs.link import self_reports
from gcs.link.feed import SPEED_MAX_M_S, VehicleFeed
from gcs.link.heights import BAROMETER, GPS, RANGEFINDER
from tests.gcs.link.test_self_reports import SYSTEM, Subscriptions

PERIOD_S = 0.1
AUTOPILOT: Any = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)


class Vehicle:
    """A feed whose messages a test sends; its clock is the test's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(feed_module, "TelemetryPlugin", Subscriptions)
        monkeypatch.setattr(self_reports, "MavlinkDirect", Subscriptions)
        self.now_s = 0.0
        clock: Any = SimpleNamespace(now_s=lambda: self.now_s, time_scale=1.0)
        system = SimpleNamespace(
            autopilot_type=lambda: Autopilot.PX4,
            get_system_id=lambda: SYSTEM,
            is_connected=lambda: True,
            subscribe_is_connected=lambda take: None,
        )
        posted: Any = SimpleNamespace(post=lambda take, *values: take(*values))
        self.frames: dict[int, Callable[[bytes], object]] = {}
        self.feed = VehicleFeed(system, MissionFrame(Geodetic(47.4, 8.5, 488.0)), clock, posted, self.frames.update)
        self.feed.on_return = lambda: None
        self.feed.subscribe()
        self.feed.locate((0.0, 0.0, 0.0))

    def receive(self, name: str, value: object) -> None:
        self.feed.plugin.taken[name](value)

    def is_at(self, x: float, height_m: float) -> None:
        """Receive a motion, a period after the last one."""
        self.now_s += PERIOD_S
        self.hear(common.MAVLink_local_position_ned_message(0, x, 0.0, -height_m, 0.0, 0.0, 0.0))

    def hear(self, message: common.MAVLink_message) -> None:
        """Receive a frame."""
        self.frames[message.get_msgId()](bytes(message.pack(AUTOPILOT)))

    def measures(self, barometer_m: float, clearance_m: float = nan) -> tuple[float | None, str]:
        """Receive an ALTITUDE; return the height's offset and the sensor that shows it."""
        self.receive("altitude", SimpleNamespace(altitude_monotonic_m=barometer_m, bottom_clearance_m=clearance_m))
        return self.feed.status.height_off_m, self.feed.status.height_sensor

    def receives_gps(
        self, altitude_m: float, sigma_m: float, fix: FixType = FixType.FIX_3D
    ) -> tuple[float | None, str]:
        """Receive a GPS_RAW_INT; return the height's offset and the sensor that shows it."""
        self.receive("gps_info", SimpleNamespace(fix_type=fix, num_satellites=14))
        self.receive("raw_gps", SimpleNamespace(absolute_altitude_m=altitude_m, vertical_uncertainty_m=sigma_m))
        return self.feed.status.height_off_m, self.feed.status.height_sensor

    def climbs(self, to_m: float) -> None:
        """Stand on the ground, where the barometer shows 100 m, arm, and climb."""
        self.is_at(0.0, 0.0)
        self.measures(100.0)
        self.receive("armed", True)
        for decimetre in range(1, round(10.0 * to_m) + 1):
            self.is_at(0.0, decimetre / 10.0)
            self.measures(100.0 + decimetre / 10.0)


@pytest.fixture
def vehicle(monkeypatch: pytest.MonkeyPatch) -> Vehicle:
    return Vehicle(monkeypatch)


@pytest.mark.parametrize(
    ("barometer_m", "clearance_m", "expected"),
    [
        (108.0, nan, (0.0, BAROMETER)),
        (108.0, 2.0, (6.0, RANGEFINDER)),  # it is low, and its barometer drifts with the height
        (nan, 2.0, (6.0, RANGEFINDER)),
        (nan, nan, (None, "")),
        (nan, -1.0, (None, "")),
        (108.0, -1.0, (0.0, BAROMETER)),
        (108.0, 30.0, (0.0, BAROMETER)),  # a slope
        (101.0, 2.0, (7.0, BAROMETER)),
        (107.0, 2.0, (6.0, RANGEFINDER)),
    ],
)
def test_the_clearance_counts_where_it_is_less_than_half_the_height(
    vehicle: Vehicle, barometer_m: float, clearance_m: float, expected: tuple[float | None, str]
) -> None:
    vehicle.climbs(8.0)
    assert vehicle.measures(barometer_m, clearance_m) == expected


@pytest.mark.parametrize(
    ("stood_sigma_m", "sigma_m", "height_m", "expected"),
    [
        (0.3, 0.3, 14.0, 4.5),  # 6.0 - 3 * 0.42
        (0.3, 0.3, 2.0, -4.5),
        (1.5, 1.5, 14.0, 0.0),  # 3 * 2.12 explain it
        (0.3, 1.5, 14.0, 1.5),  # 6.0 - 3 * 1.53
        (0.0, 0.0, 20.0, 0.0),  # not stated: 3 * 4.24
        (0.0, 0.0, 26.0, 5.5),
    ],
)
def test_the_height_of_a_gps_counts_beyond_what_its_accuracy_explains(
    vehicle: Vehicle, stood_sigma_m: float, sigma_m: float, height_m: float, expected: float
) -> None:
    """The autopilot flies at `height_m` by a barometer that is wrong, and is at 8 m."""
    vehicle.is_at(0.0, 0.0)
    vehicle.receives_gps(530.0, 1.0)
    vehicle.receives_gps(531.0, stood_sigma_m)
    vehicle.receive("armed", True)
    for decimetre in range(1, round(10.0 * height_m) + 1):
        vehicle.is_at(0.0, decimetre / 10.0)
    assert vehicle.receives_gps(539.0, sigma_m) == (expected, GPS)
    assert vehicle.receives_gps(539.0, sigma_m, FixType.FIX_2D) == (None, "")


@pytest.mark.parametrize("is_lost", [True, False])
@pytest.mark.parametrize("jumped_m", [6.0, -6.0])
def test_a_height_that_jumps_in_a_silence_is_told_by_the_barometer(
    vehicle: Vehicle, is_lost: bool, jumped_m: float
) -> None:
    vehicle.climbs(8.0)
    vehicle.now_s += 2.0
    if is_lost:
        vehicle.feed.lose()
        vehicle.feed.locate((0.0, 0.0, 0.0))
    vehicle.is_at(0.0, 7.0 + jumped_m)  # it has sunk by 1 m
    assert vehicle.measures(107.0) == (0.0, BAROMETER)
    reference = vehicle.feed.status.reference
    assert (reference.moves, reference.jumps, reference.jumped_m) == (0, 1, (0.0, 0.0, jumped_m))
    for _ in range(3):
        vehicle.is_at(0.0, 7.0 + jumped_m)
        assert vehicle.measures(107.0) == (0.0, BAROMETER)
    assert vehicle.feed.position_m == pytest.approx((0.0, 0.0, 7.0))
    assert vehicle.feed.status.reference == reference


def test_a_descent_in_a_silence_is_no_jump(vehicle: Vehicle) -> None:
    vehicle.climbs(8.0)
    vehicle.now_s += 10.0
    vehicle.feed.lose()
    vehicle.feed.locate((0.0, 0.0, 0.0))
    vehicle.measures(100.5)  # before the first motion: the height is not known yet
    vehicle.is_at(0.0, 0.5)
    assert vehicle.measures(100.5) == (0.0, BAROMETER)
    assert vehicle.feed.status.reference.jumps == 0


@pytest.mark.parametrize(("away_m", "jumps"), [(0.9, 0), (1.1, 1)])
def test_a_place_that_cannot_be_reached_in_a_silence_is_a_jump(vehicle: Vehicle, away_m: float, jumps: int) -> None:
    """`away_m` is a share of what a vehicle flies at its largest speed."""
    vehicle.climbs(8.0)
    vehicle.now_s += 10.0 - PERIOD_S
    vehicle.feed.lose()
    vehicle.feed.locate((0.0, 0.0, 0.0))
    vehicle.is_at(away_m * SPEED_MAX_M_S * 10.0, 8.0)
    vehicle.is_at(away_m * SPEED_MAX_M_S * 10.0, 8.0)
    reference = vehicle.feed.status.reference
    assert reference.jumps == jumps
    if jumps:
        assert reference.jumped_m == pytest.approx((220.0, 0.0, 0.0))
        assert vehicle.feed.position_m == pytest.approx((220.0, 0.0, 8.0))


def test_a_damaged_frame_is_no_message(vehicle: Vehicle) -> None:
    vehicle.hear(common.MAVLink_attitude_message(1000, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0))
    vehicle.is_at(1.0, 2.0)
    assert (vehicle.feed.status.tilt_deg, vehicle.feed.motions) == (29, 1)
    for message in (
        common.MAVLink_attitude_message(0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        common.MAVLink_local_position_ned_message(0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ):
        frame = bytes(message.pack(AUTOPILOT))
        vehicle.frames[message.get_msgId()](frame[:-1] + bytes((frame[-1] ^ 1,)))
    assert (vehicle.feed.status.tilt_deg, vehicle.feed.motions) == (29, 1)
    assert vehicle.feed.position_m == (1.0, 0.0, 2.0)
