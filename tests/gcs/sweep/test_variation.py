import pytest

from gcs.errors import InputError
from gcs.mission.overrides import override, override_text
from gcs.sweep.variation import Variation, seed_range, variation


def test_values_are_read_as_written(subtests: pytest.Subtests) -> None:
    for given, values in (
        ("8:10", (8, 9)),
        ("16:8:-4", (16, 12)),
        ("0:0.3:0.1", (0.0, 0.1, 0.2)),  # in binary 0.1 + 0.1 + 0.1 is not below 0.3
        ("1e1:3e1:1e1", (10.0, 20.0)),
        ("line,wedge", ("line", "wedge")),
        ("[0.1, 0.0],[0.2, 0.0]", ([0.1, 0.0], [0.2, 0.0])),
        ("udpin://127.0.0.1:14540", ("udpin://127.0.0.1:14540",)),
        ("[" * 5000, ("[" * 5000,)),
        ("9" * 5000, ("9" * 5000,)),
    ):
        with subtests.test(given=given):
            found = variation(f"a.key={given}")
            assert found == Variation("a.key", values)
            assert [type(value) for value in found.values] == [type(value) for value in values]


def test_seeds_are_a_range_or_a_list() -> None:
    assert seed_range("0:4") == (0, 1, 2, 3)
    assert seed_range("7, 3") == (7, 3)


def test_what_cannot_be_varied_is_named(subtests: pytest.Subtests) -> None:
    for given, named in (
        ("encirclement.radius_m=", "KEY=START:STOP:STEP"),
        ("=8:16", "KEY=START:STOP:STEP"),
        ("r=16:8:2", "from 16 to 8 (excluded) in steps of 2"),
        ("r=8:8:1", "empty"),
        ("r=8:16:0", "the step is 0"),
        ("r=8:x:2", "'x' is not a number"),
        ("r=8:1e999", "'1e999' is not a number"),
        ("r=0:1e9", "1000000000 values"),
        ("r=8,9,8.0", "8.0 is given twice"),
        ("r=1,inf", "inf is not finite"),
        (f"r=1,{10**400}", "0 is too large"),
    ):
        with subtests.test(given=given), pytest.raises(InputError) as error:
            variation(given)
        assert named in str(error.value)
        assert str(error.value).startswith(f"--vary {given}: ")


def test_what_is_no_seed_is_named(subtests: pytest.Subtests) -> None:
    for given, named in (
        ("-1:2", "-1"),
        ("0.5", "0.5"),
        ("a:2", "'a:2'"),
        ("3,3", "3"),
        ("5:1", "empty"),
        ("", "''"),
        (f"{2**63}", "large"),
    ):
        with subtests.test(given=given), pytest.raises(InputError, match=f"--seeds {given}: .*{named}"):
            seed_range(given)


def test_an_override_as_text_is_read_back(subtests: pytest.Subtests) -> None:
    for value in ("wedge", "8", "", 'q"', 8, 1e-7, True, [1, [2.5, "x"]], {"a": 1, "b c": [True]}):
        with subtests.test(value=value):
            assert override(override_text("a.key", value)) == ("a.key", value)
