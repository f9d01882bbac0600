"""When a vehicle that joined a flight comes home with the others: once all that it receives do, not for one of them."""

import pytest

from agents.team.messages import MemberState
from gcs.flight.added_flight import coming_home


def team(*tactics: str) -> list[MemberState]:
    here, rest = (0.0, 0.0), (0.0, 0.0)
    return [MemberState(i, 1.0, tactic, here, rest, here, rest) for i, tactic in enumerate(tactics, 1)]


@pytest.mark.parametrize(
    ("tactics", "home"),
    [
        (("return and land", "return and land", "land"), (1, 2, 3)),
        (("land",), (1,)),
        (("return and land", "pilot override", "land"), (1, 3)),
        (("encircle", "return and land", "encircle"), ()),
        (("return and land", "hold", "land"), ()),
        (("standby", "land"), ()),
        (("pilot override", "pilot override"), ()),
        ((), ()),
    ],
)
def test_all_that_no_pilot_flies_have_to_come_home(tactics: tuple[str, ...], home: tuple[int, ...]) -> None:
    assert coming_home(team(*tactics)) == home
