"""Admission: a message counts on the one key of its type and its sender."""

import pytest

from agents.drops import Drops, Reason
from agents.team.codec import Admission, encode, refusal
from agents.team.messages import (
    PEER_TOPICS,
    BusMessage,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    StartProposal,
    TargetPackage,
    VehicleReport,
    key_of,
)
from agents.team.participant import Participant, name_from, vehicle

KEYS: dict[str, BusMessage] = {
    "member/3": MemberState(3, 5.0, "formation", (9.0, 0.0), (0.0, 0.0), (9.0, 0.0), (0.0, 0.0)),
    "start/3": StartProposal(3, 5.0, 7.0),
    "answer/3": CommandAnswer(3, 5.0, 7, "motors cut"),
    "@report/3": VehicleReport(3, 5.0, "offboard"),
    "command/hold/pat": OperatorCommand(5.0, "hold", None, "pat", 7),
}
OTHERS = (
    *("", "member", "member/", "member/03", "member/3/", "/member/3", "member/1", "answer/2", "command/pat", "x/3"),
    *("command/kill/pat", "command/hold/eve", "command/hold/3", "perception/3", "command/hold/pat/3"),
)


def test_each_type_has_one_key() -> None:
    for key, message in KEYS.items():
        assert key_of(message) == key
        assert refusal(key, message) is None
        for other in (*KEYS, *OTHERS):
            if other != key:
                assert refusal(other, message) in (Reason.WRONG_TOPIC, Reason.WRONG_SENDER)
    assert {key.split("/")[0] for key in KEYS} == PEER_TOPICS | {"command"}


@pytest.mark.parametrize("message", KEYS.values(), ids=lambda message: type(message).__name__)
def test_nothing_in_the_name_of_another_is_admitted(message: BusMessage) -> None:
    """A message on the key of vehicle 1, of another operator or of another topic leaves no trace but its count."""
    admission, payload = Admission(), encode(message)
    topic = key_of(message).split("/")[0]
    same_topic = "command/hold/eve" if topic == "command" else f"{topic}/1"
    assert admission.admitted(same_topic, payload) is None
    assert admission.admitted("answer/1" if topic == "member" else "member/1", payload) is None
    assert admission.admitted(key_of(message), payload[:-1]) is None
    assert admission.drops == Drops(wrong_sender=1, wrong_topic=1, malformed=1)
    assert admission.admitted(key_of(message), payload) == message


def test_the_parts_of_a_state_are_its_senders() -> None:
    """The sender of a state has no way to name another vehicle in its parts."""
    angle = NeighbourAngle(1, 4.0, 0.5, 0.05, 10.0)
    package = TargetPackage(1, 4.0, (8.0, -5.0), (0.1, 0.0, 0.1), 0.8, 0.2, (2,))
    here = (9.0, 0.0)
    state = MemberState(3, 5.0, "encircle", here, here, here, here, angle=angle, sightings=(package,))
    received = Admission().admitted("member/3", encode(state))
    assert isinstance(received, MemberState)
    assert received.angle is not None
    assert {received.angle.sender, *(each.sender for each in received.sightings)} == {3}


def test_names_are_safe_in_keys_and_on_terminals() -> None:
    for role, name in (
        ("operator", "a/b"),
        ("operator", ""),
        ("sensor", "*"),
        ("operator", "a" * 33),
        ("vehicle", "x"),
    ):
        with pytest.raises(ValueError, match=role):
            Participant(role, name)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="number"):
        Participant("vehicle", "03")
    assert (vehicle(3).vehicle_id, Participant("operator", "3").vehicle_id) == (3, None)
    for text in ("pat@field computer", "\x1b[2J", "jürgen", "a/b/c" * 20, ""):
        assert Participant("operator", name_from(text)).name
    assert name_from("pat@field computer") == "pat-field-computer"
