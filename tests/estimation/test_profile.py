"""Profiles: what is bundled, what a user's own may say, and how its faults are reported."""

from pathlib import Path

import pytest

from estimation.plant.model import IdentifiedLog, Plant, PlantAxis, PlantGrade
from estimation.profile.profile import LimitsSection, ProfileError, ProfileLibrary
from estimation.settings import OwnFilterSettings

AXES = "[x]\na0_per_s2 = 0.5\na1_per_s = 1\n[y]\na0_per_s2 = 0.6\na1_per_s = 1.1\n"
IDENTIFIED = f"""
[identified]
method = "output error 1"
date = "2026-11-21"
vehicle = 3
autopilot = "px4"
firmware = "v1.17.0"
setpoints = "held"
duration_s = 148.3
fit_x_percent = 86.0
fit_y_percent = 79.0
verdict = "usable"
reasons = ["the estimator wandered"]
covariance = {[[0.01 if row == column else 0.0 for column in range(5)] for row in range(5)]}

[[identified.logs]]
name = "flight.ulg"
sha256 = "{"0a" * 32}"
"""


def test_the_bundled_profiles_hold_the_numbers_of_their_autopilots(tmp_path: Path) -> None:
    px4, ardupilot, noisy, stub = (ProfileLibrary(tmp_path).load(n) for n in ("px4", "ardupilot", "stub-noisy", "stub"))
    assert [each.autopilot for each in (px4, ardupilot, noisy, stub)] == ["px4", "ardupilot", None, None]
    assert noisy.own_filter == OwnFilterSettings(position_noise_m=0.1, velocity_noise_m_s=0.05)
    assert stub.own_filter == OwnFilterSettings()
    assert noisy.plant == ProfileLibrary(tmp_path).load("stub-delayed").plant
    assert px4.limits == LimitsSection(speed_max_m_s=12.0, acceleration_max_m_s2=3.0)


def test_texts_that_were_read_load_the_same_profiles_anywhere(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(AXES + "[own_filter]\ngate_sigma = 6.0\n")
    here = ProfileLibrary(tmp_path)
    profiles = here.load("own.toml"), here.load("px4")
    there = ProfileLibrary(Path("/nowhere"), here.texts)
    assert (there.load("own.toml"), there.load("px4")) == profiles
    assert profiles[0].own_filter.gate_sigma == 6.0


def test_a_file_of_the_users_own_is_found_beside_the_mission(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("delay_s = 0.2\nfeedforward = 0.9\n" + AXES)
    assert ProfileLibrary(tmp_path).load("own.toml").plant == Plant(PlantAxis(0.5, 1.0), PlantAxis(0.6, 1.1), 0.2, 0.9)


def test_a_missing_file_names_the_bundled_ones(tmp_path: Path) -> None:
    with pytest.raises(
        ProfileError, match=r"no profile 'stubb' .*bundled profiles: ardupilot, px4, stub, stub-delayed"
    ):
        ProfileLibrary(tmp_path).load("stubb")


def test_a_fault_is_reported_with_its_path(subtests: pytest.Subtests, tmp_path: Path) -> None:
    for content, fault in (
        (b"a0 = = 1", "'own.toml' is not TOML"),
        (b"\xff\xfe", "'own.toml' is not TOML"),
        (AXES.encode() + b"extra = 1\n", "own.toml: y.extra: Extra inputs are not permitted"),
        (b"feedforward = -1\n" + AXES.encode(), "own.toml: feedforward: Input should be greater than or equal to 0"),
        (AXES.replace("0.6", "nan").encode(), "own.toml: y.a0_per_s2: Input should be a finite number"),
        (b"autopilot = 'mine'\n" + AXES.encode(), "own.toml: autopilot: Input should be 'px4' or 'ardupilot'"),
        (AXES.encode() + b"[own_filter]\ngate = 5", "own.toml: own_filter.gate: Extra inputs are not permitted"),
        (AXES.encode() + b"[limits]\nspeed_max_m_s = inf", "own.toml: limits.speed_max_m_s: Input should be a finite"),
        (AXES.replace("0.6", "-0.6").encode(), "own.toml: y: a0_per_s2 = -0.6 makes the plant unstable"),
    ):
        with subtests.test(fault=fault):
            (tmp_path / "own.toml").write_bytes(content)
            with pytest.raises(ProfileError) as caught:
                ProfileLibrary(tmp_path).load("own.toml")
            assert len(caught.value.faults) == 1
            assert caught.value.faults[0].startswith(fault)


@pytest.mark.parametrize("wrong", [{"0.5": "-0.5", "0.6": "0.0"}, {"a0_per_s2 = 0.5\n": "", "1.1": "true"}])
def test_all_faults_are_reported_at_once(wrong: dict[str, str], tmp_path: Path) -> None:
    content = AXES
    for right, fault in wrong.items():
        content = content.replace(right, fault)
    (tmp_path / "own.toml").write_text(content)
    with pytest.raises(ProfileError) as caught:
        ProfileLibrary(tmp_path).load("own.toml")
    assert [fault.split(":")[1].strip()[0] for fault in caught.value.faults] == ["x", "y"]


def test_a_file_holds_how_its_plant_was_identified(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(AXES + IDENTIFIED)
    file = ProfileLibrary(tmp_path).load("own.toml")
    assert file.plant == Plant(PlantAxis(0.5, 1.0), PlantAxis(0.6, 1.1))
    identified = file.identified
    assert identified is not None
    assert (identified.verdict, identified.date, identified.vehicle) == (PlantGrade.USABLE, "2026-11-21", 3)
    assert identified.logs == (IdentifiedLog(name="flight.ulg", sha256="0a" * 32),)
    assert [identified.covariance[at][at] for at in range(5)] == [0.01] * 5


def test_a_fault_in_the_identified_section_is_reported_with_its_path(subtests: pytest.Subtests, tmp_path: Path) -> None:
    rows: tuple[tuple[str, str, str], ...] = (
        ('verdict = "usable"', 'verdict = "fine"', "identified.verdict: Input should be"),
        ("2026-11-21", "2026-13-21", "identified.date: String should match pattern"),
        ("[0.01, 0.0, 0.0, 0.0, 0.0], ", "", "identified: Value error, covariance must have 5 rows of 5 numbers"),
        ("[[0.01", "[[-0.01", "identified: Value error, covariance has a negative variance"),
    )
    for right, wrong, fault in rows:
        with subtests.test(right=right, wrong=wrong, fault=fault):
            assert right in IDENTIFIED
            (tmp_path / "own.toml").write_text(AXES + IDENTIFIED.replace(right, wrong, 1))
            with pytest.raises(ProfileError) as caught:
                ProfileLibrary(tmp_path).load("own.toml")
            assert [each.startswith(f"own.toml: {fault}") for each in caught.value.faults] == [True]
