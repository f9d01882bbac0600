"""The question before boards on a bench may drive their motors: another answer than the one word flies nothing."""

import sys
from io import StringIO

import pytest

from gcs.cli.fly import FlyOptions, fly
from gcs.errors import Exit


class Answer(StringIO):
    """What is typed on a terminal, or what is piped into the command."""

    def __init__(self, text: str, *, on_terminal: bool) -> None:
        super().__init__(text)
        self._on_terminal = on_terminal

    def isatty(self) -> bool:
        return self._on_terminal


@pytest.mark.parametrize(
    ("answer", "found"),
    [
        (Answer("\n", on_terminal=True), "the answer was ''"),
        (Answer("of\n", on_terminal=True), "the answer was 'of'"),
        (Answer("off\n", on_terminal=False), "there is no terminal to answer on"),
    ],
)
def test_another_answer_flies_nothing(
    answer: Answer, found: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", answer)
    assert fly(FlyOptions(mission="case2", sitl="all", bench=True)) == Exit.REFUSED
    assert found in " ".join(capsys.readouterr().err.split())
