"""Agents that wait on the ground for an operator's start, on another computer, with a router between them.

A computer without keys beside them gets nothing. The agents' processes are on one computer, as is the clock of stubs.
"""

import json
import os
import subprocess
import sys
import tomllib
from contextlib import ExitStack
from pathlib import Path
from shutil import copytree

import pytest
import tomli_w

from gcs.errors import Exit
from gcs.flightlog.audit import AuditEntry
from gcs.flightlog.reader import read_log
from gcs.keys.authority_folder import AuthorityFolder
from gcs.replay.cores import replay
from tests.support.computers import Computer, computers
from tests.support.mission_text import CASE2, LOW_M
from tests.support.wire import PATIENCE_S

pytestmark = [pytest.mark.wire, pytest.mark.long]

SPEED = "4"
"""Commands take wall time, while which the team flies on."""
HOLDERS = ("router-hill", "vehicle-1", "vehicle-2", "operator-anna")
KEYLESS, PLAIN = "keyless", "plain"
"""Who has the mission without its keys, and who has it without its security."""


def mission_text(router: Computer, **security: object) -> str:
    """Return case2 for the vehicles 1 and 2, which hold when the operator has left."""
    mission = tomllib.loads(CASE2)
    mission["vehicles"] = mission["vehicles"][:2]
    for vehicle in mission["vehicles"]:
        del vehicle["endpoint"]
        vehicle["altitude_m"] = LOW_M
    mission["formation"]["leader"] = 1
    mission["network"] = {"team": "onboard", "router": f"tcp/{router.address}:7447", "security": security}
    mission["failsafe"] = {"no_operator": "hold", "no_operator_s": 2.0}
    return tomli_w.dumps(mission)


class Site:
    """Computers of the router, of both vehicles, of the operator, and one without keys: who has which files, and runs
    which commands.
    """

    def __init__(self, hosts: list[Computer], folder: Path, stack: ExitStack) -> None:
        keys = AuthorityFolder(folder / "keys")
        keys.init(10.0)
        for role, _, name in (holder.partition("-") for holder in HOLDERS):
            keys.issue(role, name, 1.0)  # type: ignore[arg-type]
        self._places = {}
        router, vehicles, operator, other = hosts
        at = (router, vehicles, vehicles, operator, other, other)
        for holder, host in zip((*HOLDERS, KEYLESS, PLAIN), at, strict=True):
            if holder in HOLDERS:
                copytree(keys.path / holder, folder / holder / "keys" / holder)
            mission = mission_text(router, **{"insecure": True} if holder == PLAIN else {"keys": "keys"})
            (folder / holder).mkdir(exist_ok=True)
            (folder / holder / "mission.toml").write_text(mission, encoding="utf-8")
            self._places[holder] = host, folder / holder
        self._stack = stack

    def run(self, holder: str, *arguments: str) -> "subprocess.Popen[str]":
        host, folder = self._places[holder]
        environment = {**os.environ, "TERM": "dumb", "COLUMNS": "200"}
        command, pipe = host.command(sys.executable, "-m", "gcs", *arguments), subprocess.PIPE
        process = subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, text=True, env=environment)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def ended(self, holder: str, *arguments: str) -> tuple[int, str, str]:
        process = self.run(holder, *arguments)
        out, err = process.communicate(timeout=PATIENCE_S)
        return process.returncode, out, err

    def agent(self, vehicle: int) -> "subprocess.Popen[str]":
        options = ("--only", str(vehicle), "--wait-for-start", "--log", "flight.mcap")
        return self.run(f"vehicle-{vehicle}", "fly", "mission.toml", *options)


def said_until(process: "subprocess.Popen[str]", *words: str) -> str:
    """Read what a process prints until it has printed all of these, and return it."""
    assert process.stderr is not None
    said = ""
    while not all(each in said for each in words):
        line = process.stderr.readline()
        assert line, said
        said += line
    return said


def test_a_team_starts_by_its_operator_when_all_are_there_and_holds_when_the_operator_leaves(tmp_path: Path) -> None:
    with computers(4) as hosts, ExitStack() as stack:
        site = Site(hosts, tmp_path, stack)
        said_until(site.run("router-hill", "router", "mission.toml"), "Ctrl-C ends it")
        said_until(site.run("vehicle-1", "sitl", "mission.toml", "--lockstep", "--speed", SPEED), "Ctrl-C ends it")
        land = "command", "land", "--mission", "mission.toml"
        plain = site.run(PLAIN, *land)  # it calls the router for as long as an answer may take
        first = site.agent(1)
        said_until(first, "waits for its start: ready")
        code, out, _ = site.ended("operator-anna", "start", "mission.toml", "--wait", "3", "--json")
        assert code == Exit.REFUSED
        result = json.loads(out)
        assert not result["started"]
        assert [each["state"] for each in result["vehicles"]] == ["ready", "missing"]
        assert "no agent is on the bus" in result["vehicles"][1]["reason"]
        second = site.agent(2)
        watching = site.run("operator-anna", "watch", "--mission", "mission.toml")
        code, out, err = site.ended("operator-anna", "start", "mission.toml", "--wait", "60", "--json")
        assert code == Exit.HOLDS, err
        assert [each["answer"] for each in json.loads(out)["vehicles"]] == ["takes off", "takes off"]
        for flying in (first, second):
            assert "log is incomplete" not in said_until(flying, "standby -> formation")
        refusals = (
            (plain, Exit.REFUSED, "router"),
            (site.run(KEYLESS, *land), Exit.BAD_INPUT, "operator"),
            (site.run("operator-anna", "command", "kill", *land[2:], "--yes"), Exit.REFUSED, "may not command kill"),
        )
        for refused, expected, words in refusals:
            _, err = refused.communicate(timeout=PATIENCE_S)
            assert (refused.returncode, words in err) == (expected, True), err
        watching.terminate()
        for flying in (first, second):
            said_until(flying, "no operator on the bus", "formation -> hold")
        code, _, err = site.ended("operator-anna", "command", "resume", "--mission", "mission.toml")
        assert code == Exit.HOLDS, err
        code, _, err = site.ended("operator-anna", *land)
        assert code == Exit.HOLDS, err
        for vehicle, flying in enumerate((first, second), start=1):
            _, said = flying.communicate(timeout=PATIENCE_S)
            assert flying.returncode == Exit.ENDED_IN_FLIGHT
            assert "land by anna" in said
            replayed = replay(read_log(tmp_path / f"vehicle-{vehicle}" / "flight.mcap"))
            assert (replayed.same, replayed.other_versions) == (True, ())
        logs = [str(tmp_path / f"vehicle-{vehicle}" / "flight.mcap") for vehicle in (1, 2)]
        for log, other in zip(logs, (2, 1), strict=True):
            entries = (each.read(AuditEntry) for each in read_log(Path(log)).run_records if each.kind is AuditEntry)
            assert {each.vehicle for each in entries if each.event == "head"} == {other}
        code, _, err = site.ended("operator-anna", "log", "audit", *logs, "--keys", "keys")
        assert code == Exit.HOLDS, err
