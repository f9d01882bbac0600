"""What a listener makes of a team's words, and the table and lines that show it."""

from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

from agents.team.messages import (
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    encode,
)
from gcs.console.picture import SILENT_AFTER_S, TeamPicture, WatchRow
from gcs.console.watch import watch_line, watch_table
from tests.support.wording import facts_missing

ROW = WatchRow(1, 0.1, "encircle", (1.0, -2.0), 8.0, 10.02, 0.051)


def state(sender: int = 1, time_s: float = 100.0, tactic: str = "formation", alert: str = "") -> bytes:
    here = (1.0, -2.0)
    return encode(MemberState(sender, time_s, tactic, here, (0.0, 0.0), here, (0.0, 0.0), 8.0, 0.1, alert))


def test_who_has_said_nothing_has_an_empty_row() -> None:
    picture = TeamPicture((1, 2))
    assert picture.rows(0.0) == [WatchRow(1), WatchRow(2)]
    assert not picture.anybody
    picture.hear(state(3), 0.0)
    assert [row.vehicle_id for row in picture.rows(0.0)] == [1, 2, 3], "whoever speaks is shown"


def test_a_row_is_the_last_words_and_their_age() -> None:
    picture = TeamPicture((1,))
    picture.hear(state(), 5.0)
    picture.hear(encode(NeighbourAngle(1, 100.0, 0.3, 0.05, 10.5)), 5.0)
    assert picture.rows(5.25) == [WatchRow(1, 0.25, "formation", (1.0, -2.0), 8.0, 10.5, 0.05)]
    picture.hear(state(time_s=101.5), 6.0)
    (row,) = picture.rows(6.0)
    assert (row.radius_m, row.angular_rate_rad_s) == (None, None), "it has left the ring"


def test_what_is_no_message_is_left_alone(subtests: pytest.Subtests) -> None:
    for payload in [b"", b"\xc1", b"hello", b"\x90"]:
        with subtests.test():
            picture = TeamPicture((1,))
            picture.hear(payload, 0.0)
            assert picture.rows(0.0) == [WatchRow(1)]


def test_silence_is_news_once_and_so_is_its_end() -> None:
    picture = TeamPicture((1,))
    picture.hear(state(), 0.0)
    (heard,) = picture.news(0.0)
    assert facts_missing(heard, "vehicle 1", "heard", "formation") == []
    assert picture.news(SILENT_AFTER_S) == []
    (silent,) = picture.news(SILENT_AFTER_S + 0.1)
    assert facts_missing(silent, "vehicle 1", "silent", "formation") == []
    assert picture.news(SILENT_AFTER_S + 0.2) == []
    assert picture.rows(SILENT_AFTER_S + 0.2)[0].silent
    picture.hear(state(tactic="hold"), 3.0)
    again, change = picture.news(3.0)
    assert facts_missing(again, "vehicle 1", "again") == []
    assert change == "vehicle 1: formation -> hold"
    assert not picture.rows(3.0)[0].silent


def test_alerts_commands_and_answers_are_told_once_however_often_they_are_repeated() -> None:
    picture = TeamPicture((1,))
    for _ in range(3):
        picture.hear(state(alert="battery low"), 0.0)
        picture.hear(encode(OperatorCommand(100.0, "hold", None, "pat@here", 7)), 0.0)
        picture.hear(encode(CommandAnswer(1, 100.0, 7, "holds")), 0.0)
    picture.hear(state(), 0.1)
    facts = (("heard",), ("alert", "battery low"), ("pat@here", "hold"), ("answers", "holds"), ("no alert",))
    news = picture.news(0.1)
    assert [facts_missing(line, *told) for line, told in zip(news, facts, strict=True)] == [[]] * 5
    assert ["vehicle 1" in line for line in news] == [True, True, False, True, True]


def rendered(rows: list[WatchRow]) -> list[str]:
    output = StringIO()
    Console(file=output, width=80).print(watch_table(rows, 12.0, "go"))
    return output.getvalue().splitlines()


def test_the_table_shows_every_number_with_its_unit_in_eighty_columns() -> None:
    lines = rendered([ROW, replace(ROW, vehicle_id=2, age_s=3.2, alert="battery low"), WatchRow(3)])
    assert lines[0].strip() == "watched for 12 s"
    assert lines[2].split() == ["tactic", "[s", "ago]", "[m]", "[m]", "[m]", "[m]", "[rad/s]"]
    assert lines[3].split() == ["1", "encircle", "0.1", "1.0", "-2.0", "8.0", "10.02", "+0.051"]
    assert "silent for 3 s, battery low" in lines[4]
    assert "not heard" in lines[5]
    assert lines[6].strip() == "go"
    assert max(map(len, lines)) <= 80


def test_the_line_leaves_out_what_is_not_known() -> None:
    rows = [ROW, replace(ROW, radius_m=None, angular_rate_rad_s=None, age_s=2.0), WatchRow(3)]
    assert watch_line(rows, 12.0, "") == (
        "watched for 12 s | #1 encircle x=1.0m y=-2.0m height=8.0m r=10.02m w=+0.051rad/s"
        " | #1 encircle x=1.0m y=-2.0m height=8.0m silent for 2 s | #3 not heard"
    )
