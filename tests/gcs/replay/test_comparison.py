"""Decisions compared: the answers of 0.2.0 did not state an outcome."""

from agents.team.codec import encode
from agents.team.messages import CommandAnswer
from gcs.flightlog.records import Decision, Sent
from gcs.replay.comparison import differences, identical


def answered(did: str, *command: str) -> Decision:
    answer = Sent("answer", encode(CommandAnswer(1, 9.0, 7, did, *command)))  # type: ignore[arg-type]
    none = (None,) * 7
    return Decision(9.0, "hold", 0.0, None, *none, "", (), (answer,), (), (), 0)


def test_what_an_earlier_answer_did_not_tell_is_no_difference() -> None:
    recorded = answered("holds", "hold", "pat")
    (different,) = differences(recorded, answered("lands", "hold", "pat"), identical)
    assert (different.recorded, different.replayed) == ("holds", "lands")
    assert differences(recorded, answered("holds", "hold", "pat", "obeyed"), identical) == []
    (different,) = differences(answered("holds", "hold", "kim"), answered("holds", "hold", "pat"), identical)
    assert different.field.endswith("origin")
