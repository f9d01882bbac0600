"""A radio as a user writes it."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs.errors import InputError
from gcs.radio.serving import radio_spec
from sitl.radio import RadioSpec


def test_keys_and_values_are_read() -> None:
    assert radio_spec("baud=57600,latency_ms=60, jitter_ms = 30,loss=0.02,burst=3,shared,seed=4") == RadioSpec(
        baud=57600, latency_ms=60.0, jitter_ms=30.0, loss=0.02, burst=3.0, shared=True, seed=4
    )


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("bawd=57600", ["--radio.bawd: unknown key; did you mean 'baud'?"]),
        ("baud=57600,baud=9600", ["--radio.baud: it is given twice"]),
        ("loss=2", ["--radio.loss: "]),
        ("baud=nan", ["--radio.baud: "]),
        ("shared=3", ["--radio.shared: "]),
        ("baud=", ["--radio: 'baud=' is not like latency_ms=60"]),
        ("loss=0.8,burst=2", ["--radio: bursts of this length"]),
        ("loss=-1,jitter_ms=-1", ["--radio.jitter_ms", "--radio.loss"]),
    ],
)
def test_bad_input_names_the_key(text: str, faults: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        radio_spec(text)
    for fault in faults:
        assert any(each.startswith(fault) for each in caught.value.faults), caught.value.faults


@given(st.text(max_size=60))
def test_any_text_is_a_radio_or_bad_input(text: str) -> None:
    with suppress(InputError):
        assert isinstance(radio_spec(text), RadioSpec)
