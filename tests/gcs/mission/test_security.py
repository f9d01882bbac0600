"""`[network.security]` of a mission: what it may be, and where it has to be."""

from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.keys.key_folder import KeyFolder
from gcs.keys.team_keys import security_faults, team_keys
from tests.support.mission_text import Content, content, faults, parsed, put


def with_security(**values: object) -> Content:
    return put(content(), ("network", "security"), values)


def test_it_is_either_keys_or_insecure(subtests: pytest.Subtests) -> None:
    for values in ({}, {"insecure": False}, {"keys": "keys", "insecure": True}, {"keys": ""}):
        with subtests.test(values=values):
            (fault,) = faults(with_security(**values))
            assert fault.startswith("network.security")


def test_an_endpoint_beyond_this_computer_needs_it(subtests: pytest.Subtests) -> None:
    for endpoint in ("tcp/0.0.0.0:7461", "tcp/drone3.local:7461", "tcp/[fe80::1]:7461"):
        with subtests.test(endpoint=endpoint):
            mission = put(content(), ("vehicles", 1, "endpoint"), endpoint)
            (fault,) = security_faults(parsed(mission))
            assert fault.startswith("vehicles[1].endpoint")
            assert "cordon keys init" in fault
            with pytest.raises(InputError):
                team_keys(parsed(mission))
            assert security_faults(parsed(put(mission, ("network", "security"), {"insecure": True}))) == []
    for endpoint in ("udp/127.8.0.1:7999", "tcp/[::1]:7999", "tcp/localhost:7999"):
        with subtests.test(endpoint=endpoint):
            assert security_faults(parsed(put(content(), ("vehicles", 1, "endpoint"), endpoint))) == []


def test_a_router_needs_it_and_no_endpoints() -> None:
    mission = put(content(), ("network", "router"), "tcp/10.0.0.2:7447")
    for vehicle in mission["vehicles"]:
        del vehicle["endpoint"]
    (fault,) = security_faults(parsed(mission))
    assert fault.startswith("network.router: [network.security] is missing")
    secured = parsed(put(mission, ("network", "security"), {"keys": "keys"}))
    assert security_faults(secured) == []
    assert secured.network.router == "tcp/10.0.0.2:7447"


def test_the_folder_of_keys_is_beside_the_mission(tmp_path: Path) -> None:
    assert team_keys(parsed(with_security(keys="own"), tmp_path)) == KeyFolder(tmp_path / "own")
    assert team_keys(parsed(with_security(keys="/etc/cordon"), tmp_path)) == KeyFolder(Path("/etc/cordon"))


def test_an_insecure_bus_has_names_and_no_keys() -> None:
    keys = team_keys(parsed(with_security(insecure=True)))
    assert keys.identity("vehicle", "2").participant.name == "2"
    assert keys.identity("vehicle", "2").security is None
    assert keys.identity("operator").participant.name
