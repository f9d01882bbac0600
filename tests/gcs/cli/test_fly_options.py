"""What `cordon fly` makes of its options for its supervisor."""

from gcs.cli.fly import FlyOptions, _recovery


def test_the_command_that_brings_home_is_that_of_the_mission_as_it_is_flown_and_of_its_vehicles() -> None:
    whole = FlyOptions(mission="my team.toml", changes=("network.team=a b", "mission.rate_hz=10"))
    assert _recovery(whole) == ("cordon recover 'my team.toml' --set 'network.team=a b' --set mission.rate_hz=10")
    assert _recovery(FlyOptions(mission="case2", only=3)) == "cordon recover case2 --only 3"
