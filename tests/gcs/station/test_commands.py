"""Commands from pages to vehicles on a bus: who may, what has to be confirmed, and each once."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from agents.team.messages import CommandedRing, Goal
from gcs.console import command_client
from gcs.mission.file import load_mission
from tests.support.mission_text import INSECURE
from tests.support.page.station import AnsweringTeam, Station, answering_team, asked, commanding, received, station
from tests.support.several_rings import with_rings
from tests.support.wire import PATIENCE_S, until

pytestmark = pytest.mark.wire


@pytest.fixture
async def flying(mission_file: Callable[..., str], tmp_path: Path) -> AsyncIterator[tuple[Station, AnsweringTeam]]:
    mission = load_mission(mission_file("case2", INSECURE))
    async with answering_team(mission) as team, station(mission, tmp_path) as running:
        await until(lambda: running.tactics == team.tactics)
        yield running, team


async def test_a_command_reaches_whom_it_names_and_each_answer_comes_back(
    flying: tuple[Station, AnsweringTeam], subtests: pytest.Subtests
) -> None:
    running, team = flying
    async with running.connected() as page:
        await commanding(page)
        with subtests.test("all"):
            await page.send(asked("a", "hold"))
            answers = [await received(page, "answer") for _ in range(3)]
            assert {answer["vehicle_id"] for answer in answers} == {1, 2, 3}
            for answer in answers:
                assert (answer["request"], answer["verb"], answer["did"]) == ("a", "hold", "holds")
                assert answer["is_obeyed"]
                assert answer["is_final"]
                assert answer["after_s"] > 0.0
        with subtests.test("some"):
            team.received.clear()
            await page.send(asked("b", "land", [1, 3, 1]))
            answers = [await received(page, "answer") for _ in range(2)]
            assert {answer["vehicle_id"] for answer in answers} == {1, 3}
            assert {vehicle_id for vehicle_id, _ in team.received} == {1, 3}
            assert len(team.numbers("land")) == 2
        with subtests.test("a vehicle that does not answer"):
            team.silent.add(2)
            await page.send(asked("c", "hold", [2]))
            event = await received(page, "event")
            assert (event["vehicle_id"], event["text"]) == (2, "hold from the page: no answer")
            answer = await received(page, "answer")
            assert (answer["vehicle_id"], answer["did"], answer["is_obeyed"]) == (2, "no answer", False)


async def test_vehicles_whose_flight_has_ended_are_not_waited_for(
    flying: tuple[Station, AnsweringTeam], subtests: pytest.Subtests
) -> None:
    running, team = flying
    team.ended.add(2)
    client = running.commands[0]._client
    assert client is not None
    await until(lambda: 2 in client.ended)
    async with running.connected() as page:
        await commanding(page)
        with subtests.test("all"):
            await page.send(asked("a", "hold"))
            assert {(await received(page, "answer"))["vehicle_id"] for _ in range(2)} == {1, 3}
        with subtests.test("the client"):
            assert (await client.command("hold", (1, 2, 3), None)).keys() == {1, 3}
            assert await client.command("hold", (2,), 2) == {2: None}
        with subtests.test("only such"):
            await page.send(asked("b", "hold", [2]))
            answer = await received(page, "answer")
            assert (answer["vehicle_id"], answer["is_obeyed"]) == (None, False)
            assert "has ended" in answer["did"]
        with subtests.test("it flies again"):
            team.ended.clear()
            await until(lambda: not client.ended)
            assert (await client.command("hold", (1, 2, 3), None)).keys() == {1, 2, 3}


async def test_what_is_not_confirmed_or_not_known_is_not_sent(
    flying: tuple[Station, AnsweringTeam], subtests: pytest.Subtests
) -> None:
    running, team = flying
    team.tactics[2] = "pilot override"
    await until(lambda: running.tactics == team.tactics)
    refused = {
        "kill without the word": (asked("1", "kill"), "kill"),
        "kill with another word": (asked("2", "kill", confirmation="Kill"), "kill"),
        "resume of a piloted vehicle": (asked("3", "resume", [2]), "pilot"),
        "resume of a team with a piloted vehicle": (asked("4", "resume"), "vehicle 2"),
        "no vehicle": (asked("5", "hold", []), "vehicles"),
        "a foreign vehicle": (asked("6", "hold", [1, 9]), "vehicles"),
        "a verb that needs more": (asked("7", "formation"), "may not"),
        "a ring without values": (asked("11", "ring"), "no value"),
        "a ring by a number": (asked("17", "ring", ring=[12.0, None], ring_number=1), "one, without a name"),
        "a place for two": (asked("19", "goto", [1, 2], place=[1.0, 2.0]), "one vehicle"),
        "a vehicle without a place": (asked("20", "goto", [1]), "to a place"),
        "an assignment": (asked("18", "assign", [1], ring_number=0), "one ring"),
        "a ring of some": (asked("12", "ring", [1], ring=[12.0, None]), "the whole team"),
        "a ring out of sight of the target": (asked("13", "ring", ring=[20.0, None]), "sensor range"),
    }
    async with running.connected() as page:
        await commanding(page)
        for name, (request, word) in refused.items():
            with subtests.test(name):
                await page.send(request)
                answer = await received(page, "answer")
                assert answer["did"].startswith("refused: ")
                assert word in answer["did"]
                assert answer["vehicle_id"] is None
                assert answer["is_final"]
        await asyncio.sleep(0.3)
        assert team.received == []
        with subtests.test("confirmed"):
            await page.send(asked("8", "kill", [1], confirmation="kill"))
            await page.send(asked("9", "resume", [2], overrides_pilot=True))
            await page.send(asked("10", "resume", [1, 3]))
            await until(lambda: len(team.numbers("kill")) == 1 and len(team.numbers("resume")) == 3)
            await page.send(asked("21", "goto", [2], place=[28.0, -4.0, True]))
            await until(lambda: len(team.numbers("goto")) == 1)
            assert next(each.place for _, each in team.received if each.verb == "goto") == Goal(28.0, -4.0, lands=True)
            await page.send(asked("14", "ring", ring=[12.0, -0.05]))
            await until(lambda: len(team.numbers("ring")) == 1)
            await page.send(asked("22", "look", [1], place=[28.0, -4.0, False]))
            await page.send(asked("23", "look", [1]))
            await until(lambda: len(team.numbers("look")) == 2)
            assert {each.place for _, each in team.received if each.verb == "look"} == {Goal(28.0, -4.0), None}
        with subtests.test("one value is checked with the ring that was commanded before"):
            await page.send(asked("15", "ring", ring=[None, 0.2]))  # 2 m/s on the mission's 10 m
            await until(lambda: len(team.numbers("ring")) == 2)
            team.ring = CommandedRing(14.0, time.time())
            await until(lambda: running.ring_radii_m == {14.0})
            await page.send(asked("16", "ring", ring=[None, 0.2]))
            while (answer := await received(page, "answer"))["request"] != "16":
                pass
            assert "2.80 m/s along the ring" in answer["did"]
            assert answer["is_final"]
            assert len(team.numbers("ring")) == 2


def seen(request: str, position_m: tuple[float, float], sigma_m: float, **more: object) -> str:
    return json.dumps({"kind": "sighting", "request": request, "position_m": position_m, "sigma_m": sigma_m, **more})


async def test_a_place_on_the_map_becomes_a_sighting_of_the_target(
    flying: tuple[Station, AnsweringTeam], subtests: pytest.Subtests
) -> None:
    running, team = flying
    async with running.connected() as page:
        await commanding(page)
        with subtests.test("sent"):
            await page.send(seen("a", (28.0, -4.0), 3.0))
            event = await received(page, "event")
            assert "28.0" in event["text"]
            assert running.commands[0].rights.name in event["text"]
            answer = await received(page, "answer")
            assert (answer["request"], answer["verb"], answer["vehicle_id"]) == ("a", "target", None)
            assert answer["is_obeyed"]
            assert answer["is_final"]
            assert "1, 2, 3" in answer["did"]
            assert {vehicle_id for vehicle_id, _ in team.sightings} == {1, 2, 3}
            for _, sighting in team.sightings:
                assert (sighting["frame"], sighting["position"]) == ("mission", [28.0, -4.0])
                assert sighting["covariance_m2"] == [9.0, 0.0, 9.0]
                assert abs(sighting["time_s"] - time.time()) < PATIENCE_S
        refused = {
            "a target that there is not": (seen("b", (28.0, -4.0), 3.0, target=1), "one, unnamed"),
            "too far away": (seen("c", (2e6, 0.0), 3.0), "2000 km"),
        }
        team.sightings.clear()
        for name, (request, word) in refused.items():
            with subtests.test(name):
                await page.send(request)
                answer = await received(page, "answer")
                assert not answer["is_obeyed"]
                assert word in answer["did"]
        assert not team.sightings
    with subtests.test("no standard deviation"):
        async with running.connected() as page:
            await page.send(seen("d", (28.0, -4.0), 0.0))
            await page.wait_closed()
            assert page.close_code == 1007


async def test_one_of_several_rings_is_changed_and_vehicles_are_assigned_to_it(
    mission_file: Callable[..., str], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    mission = with_rings(load_mission(mission_file("case2", INSECURE)))
    refused = {
        "no ring": (asked("1", "ring", ring=[12.0, None]), "names no ring"),
        "a ring that there is not": (asked("2", "ring", ring=[12.0, None], ring_number=3), "north, south, high"),
        "a ring beyond its own bounds": (asked("3", "ring", ring=[None, 0.18], ring_number=1), "ring south"),
        "a ring of some": (asked("4", "ring", [1], ring=[12.0, None], ring_number=1), "the whole team"),
        "an assignment of all": (asked("5", "assign", ring_number=1), "select"),
        "to a ring that there is not": (asked("6", "assign", [1], ring_number=4), "north, south, high"),
    }
    async with answering_team(mission) as team, station(mission, tmp_path) as running:
        await until(lambda: running.tactics == team.tactics)
        async with running.connected() as page:
            await commanding(page)
            for name, (request, word) in refused.items():
                with subtests.test(name):
                    await page.send(request)
                    answer = await received(page, "answer")
                    assert answer["did"].startswith("refused: ")
                    assert word in answer["did"]
            assert team.received == []
            await page.send(asked("7", "ring", ring=[12.0, None], ring_number=1))
            await page.send(asked("8", "assign", [1, 3], ring_number=2))
            await page.send(asked("9", "assign", [2]))
            await until(lambda: len(team.numbers("ring")) == 1 and len(team.numbers("assign")) == 3)
    sent = {(each.verb, each.vehicle, each.ring_number) for _, each in team.received}
    assert sent == {("ring", None, 1), ("assign", 1, 2), ("assign", 3, 2), ("assign", 2, None)}


async def test_a_request_is_sent_once_and_to_its_end_though_its_page_is_gone(
    flying: tuple[Station, AnsweringTeam], subtests: pytest.Subtests
) -> None:
    running, team = flying
    team.silent = {1, 2, 3}
    async with running.connected() as page:
        await commanding(page)
        await page.send(asked("a", "land"))
        await until(lambda: len(team.received) > 2)
        page.transport.abort()
    before = len(team.received)
    async with running.connected() as page:
        await commanding(page)
        with subtests.test("it goes on, and is not begun anew"):
            await page.send(asked("a", "land"))
            await until(lambda: len(team.received) > before + 9)
            assert len(team.numbers("land")) == 1
        with subtests.test("the page that asks again is answered"):
            team.silent.clear()
            answers = [await received(page, "answer") for _ in range(3)]
            assert {answer["vehicle_id"] for answer in answers} == {1, 2, 3}
        with subtests.test("once it is over, too"):
            sent = len(team.received)
            await page.send(asked("a", "land"))
            answers = [await received(page, "answer") for _ in range(3)]
            assert {answer["did"] for answer in answers} == {"holds"}
            await asyncio.sleep(0.3)
            assert len(team.received) == sent


async def test_a_hold_does_not_wait_for_a_vehicle_that_is_dead(
    mission_file: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = load_mission(mission_file("case2", INSECURE))
    async with answering_team(mission, dead=3) as team, station(mission, tmp_path) as running:
        await until(lambda: running.tactics.keys() == {1, 2})
        async with running.connected() as page:
            await commanding(page)
            await asyncio.sleep(2.0 * command_client._ALL_RECEIVED_TIMEOUT_S)  # since the first vehicle was received
            monkeypatch.setattr(command_client, "_POLL_S", 3.0 * PATIENCE_S)  # whatever is waited for takes as long
            await page.send(asked("1", "hold"))
            await until(lambda: len(team.received) >= 2)
