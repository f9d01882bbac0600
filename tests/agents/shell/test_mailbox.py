"""The mailbox: bounded in what waits, in how fast it may come, and in how many senders it tells apart."""

import threading

from agents.drops import Drops
from agents.shell.mailbox import PAYLOAD_LIMIT_BYTES, Mailbox

MEMBERS = (1, 2, 3)


def put(mailbox: Mailbox, key: str, payload: bytes = b"x", now_s: float = 100.0) -> bool:
    return mailbox.put(key, len(payload), lambda: payload, now_s)


def unread() -> bytes:
    raise AssertionError("a payload was copied that is dropped")


def test_the_newest_start_of_each_sender_waits() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    calls = [put(mailbox, f"start/{sender}", b"%d" % number) for number in range(5) for sender in (2, 3)]
    assert calls == [True] + [False] * 9, "one call until it is taken"
    assert mailbox.take() == ({}, [("start/2", b"4"), ("start/3", b"4")])
    assert mailbox.take() == ({}, [])
    assert mailbox.drops == Drops(superseded=8)
    assert put(mailbox, "member/2")


def test_states_answers_and_commands_wait_together_up_to_a_limit() -> None:
    mailbox = Mailbox((1,), MEMBERS, 1000.0)
    for key, kept in (("member/2", 4), ("answer/2", 16), ("command/hold/pat", 8), ("perception/camera", 32)):
        for number in range(kept + 5):
            put(mailbox, key, b"%d" % number)
        assert mailbox.take()[1] == [(key, b"%d" % number) for number in range(5, kept + 5)]


def test_commands_of_an_operator_wait_in_order_whatever_their_verb() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    keys = ["command/hold/pat", "command/resume/pat", "command/kill/pat"]
    for key in keys:
        put(mailbox, key)
    assert [key for key, _ in mailbox.take()[1]] == keys


def test_what_cannot_be_a_message_is_dropped_unread() -> None:
    keys = {
        "not_a_member": ("member/9", "answer/x", "member/02", "member/"),
        "own_id": ("member/1", "start/1"),
        "unknown_key": (
            *("", "member", "junk/2", "member/2/", "command/hold", "command/hold/a b", "command/fly/pat", "perception"),
            *(
                "command/hold/pat/2",
                "perception/\x1b[2J",
                "alive/2",
                f"perception/{'a' * 33}",
                "/" * 1000,
                "member/2/2",
            ),
        ),
    }
    for reason, refused in keys.items():
        mailbox = Mailbox((1,), MEMBERS, 100.0)
        assert not any(mailbox.put(key, 1, unread, 100.0) for key in refused)
        assert mailbox.drops == Drops(**{reason: len(refused)})
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    assert not mailbox.put("member/2", 100_000_000, unread, 100.0)
    assert not mailbox.put("command/hold/pat", PAYLOAD_LIMIT_BYTES + 1, unread, 100.0)
    assert put(mailbox, "member/2", bytes(PAYLOAD_LIMIT_BYTES))
    assert mailbox.drops == Drops(too_long=2)


def test_own_vehicles_are_received_from_this_process_only() -> None:
    mailbox = Mailbox((1, 2), MEMBERS, 100.0)
    assert mailbox.put("member/1", 1, lambda: b"own", 100.0, own=True)
    assert not mailbox.put("member/2", 1, unread, 100.0)
    assert not mailbox.put("member/3", 1, unread, 100.0, own=True)
    assert mailbox.take()[1] == [("member/1", b"own")]
    assert mailbox.drops == Drops(own_id=1, not_a_member=1)
    mailbox.put("member/3", 1, lambda: b"peer", 100.0)
    assert mailbox.take()[1] == [("member/3", b"peer")]


def test_a_sender_has_a_rate_and_takes_none_from_others() -> None:
    mailbox = Mailbox((1,), MEMBERS, 50.0)
    taken = {"answer/2": 0, "answer/3": 0, "member/2": 0, "command/hold/pat": 0}
    for millisecond in range(10_000):
        now_s = 100.0 + millisecond * 1e-3
        put(mailbox, "answer/2", now_s=now_s)
        if millisecond % 100 == 0:
            for key in ("answer/3", "member/2", "command/hold/pat"):
                put(mailbox, key, now_s=now_s)
        for key, _ in mailbox.take()[1]:
            taken[key] += 1
    assert 500 <= taken.pop("answer/2") <= 526
    assert set(taken.values()) == {100}


def test_operators_without_number_do_not_displace_one_that_is_known() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    put(mailbox, "command/hold/pat", now_s=100.0)
    assert len(mailbox.take()[1]) == 1
    waiting = 0
    for number in range(20_000):
        now_s = 100.0 + number * 1e-4
        put(mailbox, f"command/kill/eve{number}", now_s=now_s)
        if number % 1000 == 999:
            put(mailbox, "command/hold/pat", now_s=now_s)
            keys = [key for key, _ in mailbox.take()[1]]
            assert "command/hold/pat" in keys
            waiting = max(waiting, len(keys))
    assert waiting <= 33
    assert len(mailbox._operators._boxes) <= 32, "what is remembered of them is bounded as well"


def test_presence_is_of_members_and_the_newest_counts() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    assert mailbox.put_presence("2", True)
    for name in ("x", "02", "２", "255"):
        assert not mailbox.put_presence(name, True)
    assert not mailbox.put_presence("3", True)
    assert not mailbox.put_presence("3", False)
    assert not mailbox.put_presence("1", True), "the own vehicles as well: another of this process asks for it"
    assert mailbox.take() == ({2: True, 3: False, 1: True}, [])
    assert mailbox.drops == Drops(not_a_member=4)
    assert mailbox.put_presence("3", True)


def test_threads_lose_no_call_and_no_count() -> None:
    mailbox, calls, taken = Mailbox((1,), MEMBERS, 1e9), [0], [0]
    called, ended = threading.Semaphore(0), threading.Event()

    def send(sender: int) -> None:
        for _ in range(5000):
            if put(mailbox, f"member/{sender}"):
                called.release()

    def receive() -> None:
        while not ended.is_set() or called.acquire(blocking=False):
            if called.acquire(timeout=0.01):
                calls[0] += 1
            taken[0] += len(mailbox.take()[1])

    threads = [threading.Thread(target=send, args=(sender,)) for sender in (2, 3, 2, 3)]
    receiver = threading.Thread(target=receive)
    receiver.start()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    ended.set()
    receiver.join()
    assert taken[0] + mailbox.drops.superseded + len(mailbox.take()[1]) == 20_000


def test_what_is_refused_is_counted_by_sender_up_to_a_limit() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    mailbox.block(frozenset({"command/hold/anna", "alive/3"}))
    for _ in range(3):
        mailbox.put("command/hold/anna", 1, unread, 100.0)
    mailbox.put("member/9", 1, unread, 100.0)
    mailbox.put("\x1b/" * 5, 1, unread, 100.0)
    mailbox.put_presence("3", present=True)
    mailbox.refuse("operator-anna", "not on the roster")
    expected = {
        ("command/anna", "not a member"): 3,
        ("member/9", "not a member"): 1,
        ("others", "unknown key"): 1,
        ("alive/3", "not a member"): 1,
        ("operator-anna", "not on the roster"): 1,
    }
    assert mailbox.refusals == expected
    put(mailbox, "start/2")
    put(mailbox, "start/2")
    assert mailbox.refusals == expected, "what a newer message replaces is not refused"
    for k in range(1000):
        mailbox.put(f"junk/{k}", 1, unread, 100.0)
    assert len(mailbox.refusals) < 70
    assert sum(mailbox.refusals.values()) == 1007


def test_heads_of_audit_logs_wait_apart_and_seldom() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    for key in ("head/2", "head/3", "head/9", "head/1"):
        put(mailbox, key)
    assert mailbox.take()[1] == [("head/2", b"x"), ("head/3", b"x")]
    assert mailbox.drops == Drops(not_a_member=1, own_id=1)
    for _ in range(100):
        put(mailbox, "head/2")
    assert mailbox.drops.too_many > 80


def test_a_vehicle_outside_the_team_only_announces_itself_until_it_is_admitted() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    assert not mailbox.put_presence("9", True)
    assert put(mailbox, "start/9")
    for key in ("member/9", "answer/9", "head/9", "start/255", "start/09", "start/x"):
        assert not mailbox.put(key, 1, unread, 100.0)
    assert mailbox.take() == ({}, [("start/9", b"x")])
    assert mailbox.drops == Drops(not_a_member=6)
    mailbox.admit(9)
    assert put(mailbox, "member/9") is False, "the presence has asked for a call"
    assert mailbox.take() == ({9: True}, [("member/9", b"x")])
    assert mailbox.put_presence("9", False)


def test_those_that_announce_themselves_are_bounded_in_number_and_rate() -> None:
    mailbox = Mailbox((1,), MEMBERS, 100.0)
    kept = sum(put(mailbox, f"start/{number}", now_s=100.0) for number in range(9, 200))
    assert kept == 1
    assert len(mailbox.take()[1]) <= 10
    taken = sum(len([put(mailbox, "start/9", now_s=101.0 + k * 1e-3), *mailbox.take()[1]]) - 1 for k in range(1000))
    assert taken <= 150
    for number in range(9, 100):
        mailbox.put_presence(str(number), True)
    assert len(mailbox._present_strangers) == 32
