"""A mission with one more vehicle, which joins its flight: its identity, its text, and what it must not change."""

from collections.abc import Mapping

import pytest

from agents.team.messages import AddedVehicle
from gcs.errors import InputError
from gcs.mission.added_vehicle import recovery_command
from gcs.mission.file import enlarged_mission, joined_mission, load_mission, parse_mission

FOURTH: Mapping[str, object] = {"id": 4, "start_m": (0.0, -8.0), "url": "udpin://127.0.0.1:14999"}


def test_it_has_the_identity_of_the_mission_and_is_the_same_when_parsed_again() -> None:
    mission = load_mission("case2")
    enlarged = enlarged_mission(mission, FOURTH)
    assert enlarged.identity == mission.identity
    assert (enlarged.ids, enlarged.added, enlarged.reserves) == ((1, 2, 3, 4), 4, (4,))
    again = parse_mission(enlarged.text, None, enlarged.profile_texts)
    assert again == enlarged
    assert again.identity == mission.identity
    in_file = mission.text + '\n[[vehicles]]\nid = 4\nurl = "udpin://127.0.0.1:14999"\nstart_m = [0.0, -8.0]\n'
    assert parse_mission(in_file, None).identity != mission.identity, "one of the file counts"


def test_the_others_have_the_configuration_that_their_agents_make_of_the_announcement() -> None:
    """It is made twice: by the process of the added vehicle from the text, by the others from what it announces."""
    mission = load_mission("case2", {"choreography.layer_m": 3.0})
    enlarged = enlarged_mission(mission, FOURTH)
    for vehicle in mission.vehicles:
        config = mission.agent_config(vehicle)
        assert config.with_added(4, (0.0, -8.0)) == enlarged.agent_config(enlarged.vehicle(vehicle.id))


def test_for_metrics_it_is_known_by_its_announcement() -> None:
    joined = joined_mission(load_mission("case2"), 4, AddedVehicle((0.0, -8.0), 8.0))
    assert joined.vehicle(4).section.start_m == (0.0, -8.0)
    its_id_taken = load_mission("case2", {"vehicles[2].system_id": 4})
    assert joined_mission(its_id_taken, 4, AddedVehicle((0.0, -8.0), 8.0)).ids == (1, 2, 3, 4)
    alike = {f"vehicles[{each}].profile": "stub-feedforward" for each in range(3)}
    others = load_mission("case2", {"link.feedforward": True, **alike})
    assert joined_mission(others, 4, AddedVehicle((0.0, -8.0), 8.0)).added == 4, "it does not take the default profile"
    rings = load_mission("two-targets")
    assert joined_mission(rings, 9, AddedVehicle((0.0, -80.0), 8.0)) is rings


def test_the_command_that_brings_it_home_describes_it_as_the_one_that_added_it() -> None:
    where = {"profile": "px4", "altitude_m": 8.0, "system_id": 14, "endpoint": "tcp/127.0.0.1:7999"}
    enlarged = enlarged_mission(load_mission("case2"), {**FOURTH, "start_m": (-0.5, -8.0), **where})
    assert recovery_command(enlarged, "my case.toml", ["mission.duration_s=90"]) == (
        "cordon recover 'my case.toml' --set mission.duration_s=90 --add 4 --only 4 --start -0.5,-8 "
        "--url udpin://127.0.0.1:14999 --profile px4 --altitude 8 --system-id 14 --endpoint tcp/127.0.0.1:7999"
    )


@pytest.mark.parametrize(
    ("name", "overrides", "vehicle", "place", "said"),
    [
        ("case2", {}, {"start_m": (0.0, -6.0)}, "vehicles[3].start_m", "2.00 m from vehicles[2]"),
        ("case2", {}, {"url": "udpin://127.0.0.1:14541"}, "vehicles[3].url", "vehicles[1]'s already"),
        ("case2", {}, {"endpoint": "tcp/127.0.0.1:7461"}, "vehicles[3].endpoint", "vehicles[0]'s already"),
        ("case2", {}, {"altitude_m": 9.0}, "vehicles[3].altitude_m", "9 m would change the layers of the others"),
        ("case2", {}, {"altitude_m": 7.0}, "vehicles[3].altitude_m", "8 to 8 m is possible"),
        ("case2", {}, {"altitude_max_m": 8.5}, "vehicles[3].altitude_m", "would change the heights of the others"),
        ("case2", {}, {"slot_m": (0.0, 9.0)}, "vehicles[0].slot_m", "all have one, or none"),
        ("case2", {}, {"profile": "nowhere"}, "vehicles[3].profile", "nowhere"),
        (
            "case2",
            {"encirclement.radius_m": 1.9, "tuning.encirclement.radius_min_m": 0.5},
            {},
            "encirclement.radius_m",
            "4 vehicles on a ring of 1.9 m are 2.69 m apart",
        ),
        (
            "case2",
            {"safety.no_fly": [{"name": "shed", "center_m": [0.0, -9.0], "radius_m": 2.0}]},
            {},
            "vehicles[3].start_m",
            "'shed'",
        ),
        (
            "case2",
            {
                "safety.fence_m": [
                    [-10.0, -7.0],
                    [5.0, -7.0],
                    [5.0, -50.0],
                    [200.0, -50.0],
                    [200.0, 50.0],
                    [-10.0, 50.0],
                ]
            },
            {},
            "vehicles[3].start_m",
            "outside of safety.fence_m",
        ),
        (
            "case2",
            {"safety.rally": [{"name": "meadow", "place_m": [-50.0, 50.0]}]},
            {},
            "safety.rally",
            "a mission with rally points takes no vehicle that is not in its file",
        ),
        ("two-targets", {}, {"id": 9, "start_m": (0.0, -80.0)}, "rings", "a mission of several rings takes no vehicle"),
    ],
)
def test_what_it_must_not_change_or_cut_is_refused(
    name: str, overrides: dict[str, object], vehicle: dict[str, object], place: str, said: str
) -> None:
    with pytest.raises(InputError) as raised:
        enlarged_mission(load_mission(name, overrides), {**FOURTH, **vehicle})
    assert any(each.place == place and said in each.reason for each in raised.value.placed), raised.value.faults


def test_the_key_names_the_last_vehicle_in_reserve() -> None:
    for text in ("added = 3", "added = 9", "added = true"):
        with pytest.raises(InputError, match="added: "):
            parse_mission(f"{text}\n{load_mission('case2').text}", None)
