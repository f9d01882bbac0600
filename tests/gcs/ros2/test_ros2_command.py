"""`cordon ros2`: bad input is named, and ends in exit code 2."""

import pytest

from gcs.errors import InputError
from gcs.ros2.rmw_zenoh import topic_of
from tests.conftest import RunHere


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--sightings", "/target pose"), "'/target pose'"),
        (("--sightings", "/9/pose"), "'/9/pose'"),
        (("--sightings", "/"), "'/'"),
        (("--router", "localhost"), "'localhost'"),
        (("--router", "tcp/localhost"), "'tcp/localhost'"),
        (("--target", "boat"), "'boat'"),
        (("--domain", "233"), "232"),
        (("--sigma", "0"), "0"),
        (("no-mission",), "no-mission"),
    ],
)
def test_bad_options_are_named(run_here: RunHere, words: tuple[str, ...], named: str) -> None:
    ran = run_here("ros2", *words)
    assert ran.code == 2
    assert named in ran.err


@pytest.mark.parametrize("domain", ["x", "-1", "233", "²"])
def test_a_domain_in_the_environment_is_checked(
    run_here: RunHere, monkeypatch: pytest.MonkeyPatch, domain: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    ran = run_here("ros2")
    assert ran.code == 2
    assert f"ROS_DOMAIN_ID: '{domain}'" in ran.err


def test_topics_may_have_a_leading_slash_and_parts() -> None:
    assert [topic_of("--sightings", name) for name in ("/target/pose", "a_1/b")] == ["target/pose", "a_1/b"]
    for name in ("", "//", "/a/", "a//b", "a*", "a/1b", "é"):
        with pytest.raises(InputError):
            topic_of("--sightings", name)
