"""Decisions compared, field by field; the answers of 0.2.0 did not state an outcome."""

from typing import Any

import pytest
from msgspec import structs

from agents.team.codec import encode
from agents.team.messages import CommandAnswer
from gcs.flightlog.records import Decision, GuardResult, OwnState, Sent
from gcs.replay.comparison import differences, identical

OWN = OwnState(9.0, (0.0,) * 6, (0.0,) * 36)
PASSED = GuardResult((0.0, 0.0), "passed", (), None)


def answered(did: str, *command: str) -> Decision:
    answer = Sent("answer", encode(CommandAnswer(1, 9.0, 7, did, *command)))  # type: ignore[arg-type]
    none = (None,) * 7
    return Decision(9.0, "hold", 0.0, None, *none, "", (), (answer,), (), (), 0)


@pytest.mark.parametrize(
    "changed",
    [
        {"tactic": "land"},
        {"alert": "bus lost"},
        {"own": None},
        {"peers": (1,)},
        {"mixing": -0.0},
        {"messages_dropped": 7},
        {"guard": None},
    ],
)
def test_every_kind_of_field_is_compared(changed: dict[str, Any]) -> None:
    recorded = structs.replace(answered("holds"), own=OWN, guard=PASSED)
    assert differences(recorded, recorded, identical) == []
    (different, *_) = differences(recorded, structs.replace(recorded, **changed), identical)
    assert different.field == next(iter(changed))


def test_what_an_earlier_answer_did_not_tell_is_no_difference() -> None:
    recorded = answered("holds", "hold", "pat")
    (different,) = differences(recorded, answered("lands", "hold", "pat"), identical)
    assert (different.recorded, different.replayed) == ("holds", "lands")
    assert differences(recorded, answered("holds", "hold", "pat", "obeyed"), identical) == []
    (different,) = differences(answered("holds", "hold", "kim"), answered("holds", "hold", "pat"), identical)
    assert different.field.endswith("origin")
