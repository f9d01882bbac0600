"""Several batteries of one vehicle: the lowest that it flies with counts, and none flickers."""

from gcs.link.batteries import KEPT_S, Batteries, BatteryReport


def test_a_battery_that_the_vehicle_does_not_fly_with_is_listed_and_does_not_count() -> None:
    batteries = Batteries()
    batteries.take(BatteryReport(0, 0.9), 0.0)
    batteries.take(BatteryReport(2, 0.05, 10.0, flies=False), 0.0)
    assert (batteries.charge, batteries.endurance_s) == (0.9, None)
    assert list(batteries.newest) == [0, 2]


def test_a_value_that_becomes_unknown_is_kept_for_a_time() -> None:
    batteries = Batteries()
    batteries.take(BatteryReport(0, 0.12), 0.0)
    batteries.take(BatteryReport(0, None), KEPT_S)
    assert batteries.charge == 0.12
    batteries.take(BatteryReport(0, None), KEPT_S + 0.1)
    assert batteries.charge is None


def test_a_battery_that_stops_being_reported_is_kept_for_a_time_and_the_only_one_always() -> None:
    batteries = Batteries()
    batteries.take(BatteryReport(1, 0.12, 90.0), 0.0)
    assert batteries.charge == 0.12
    batteries.take(BatteryReport(0, 0.9), KEPT_S)
    assert (batteries.charge, batteries.endurance_s) == (0.12, 90.0)
    batteries.take(BatteryReport(0, 0.9), KEPT_S + 0.1)
    assert (batteries.charge, batteries.endurance_s) == (0.9, None)
    assert list(batteries.newest) == [0]
