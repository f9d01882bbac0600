"""A team on two computers with issued keys, and a third computer without: the team flies, the third gets nothing."""

import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import tomli_w

from gcs.errors import Exit
from gcs.keys.authority_folder import AuthorityFolder
from tests.support.computers import Computer, computers
from tests.support.mission_text import CASE2
from tests.support.wire import PATIENCE_S

pytestmark = pytest.mark.wire

Start = Callable[..., "subprocess.Popen[str]"]


def mission_text(hosts: list[Computer], **security: object) -> str:
    """Return case2 for the vehicles 1 and 2, each on its own computer."""
    mission = tomllib.loads(CASE2)
    mission["vehicles"] = mission["vehicles"][:2]
    mission["formation"]["leader"] = 1
    mission["network"] = {"security": security}
    for vehicle, host in zip(mission["vehicles"], hosts, strict=False):
        vehicle["endpoint"] = f"tcp/{host.address}:7461"
    return tomli_w.dumps(mission)


def folder_for(computer: str, mission: str, keys: Path, *holders: str) -> Path:
    """Write what one computer has: the mission, and the keys that were copied there."""
    folder = keys.parent / computer
    folder.mkdir()
    for holder in holders:
        shutil.copytree(keys / holder, folder / "keys" / holder)
    (folder / "mission.toml").write_text(mission, encoding="utf-8")
    return folder


def ended(process: "subprocess.Popen[str]") -> tuple[int, str]:
    out, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, out + err


def test_a_team_on_two_computers_flies_and_a_third_without_keys_gets_nothing(tmp_path: Path) -> None:
    keys = AuthorityFolder(tmp_path / "keys")
    keys.init(10.0)
    for vehicle in "12":
        keys.issue("vehicle", vehicle, 1.0)
    keys.issue("operator", "anna", 1.0)
    with computers(3) as (first, second, third), ExitStack() as stack:
        mission = mission_text([first, second], keys="keys")
        here = folder_for("first", mission, keys.path, "vehicle-1")
        there = folder_for("second", mission, keys.path, "vehicle-2", "operator-anna")
        elsewhere = folder_for("third", mission, keys.path)
        plain = folder_for("plain", mission_text([first, second], insecure=True), keys.path)

        def cordon(computer: Computer, folder: Path, *arguments: str) -> "subprocess.Popen[str]":
            environment = {**os.environ, "TERM": "dumb", "COLUMNS": "200"}
            command = computer.command(sys.executable, "-m", "gcs", *arguments)
            pipe = subprocess.PIPE
            process = subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, text=True, env=environment)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        flying = []
        for computer, folder, vehicle in ((first, here, "1"), (second, there, "2")):
            cordon(computer, folder, "sitl", "mission.toml", "--speed", "6")
            options = "--only", vehicle, "--speed", "6", "--duration", "400", "--no-log"
            flying.append(cordon(computer, folder, "fly", "mission.toml", *options))
        for process in flying:
            assert process.stderr is not None
            said = ""
            while "standby -> formation" not in said:
                line = process.stderr.readline()
                assert line, said
                said += line
        code, said = ended(cordon(third, elsewhere, "command", "land", "--mission", "mission.toml"))
        assert code == Exit.BAD_INPUT, said
        assert "operator" in said
        watching = cordon(third, plain, "watch", "--mission", "mission.toml")
        code, said = ended(cordon(third, plain, "command", "land", "--mission", "mission.toml"))
        assert code == Exit.REFUSED, said
        assert "no vehicle found" in said
        code, said = ended(cordon(second, there, "command", "kill", "--yes", "--mission", "mission.toml"))
        assert code == Exit.REFUSED, said
        assert "may not command kill" in said
        assert [process.poll() for process in flying] == [None, None]
        code, said = ended(cordon(second, there, "command", "land", "--mission", "mission.toml"))
        assert code == Exit.HOLDS, said
        for process in flying:
            code, said = ended(process)
            assert code == Exit.ENDED_IN_FLIGHT, said
            assert "land by anna" in said
        watching.terminate()
        code, said = ended(watching)
        assert "not received" in said
        assert "formation" not in said
