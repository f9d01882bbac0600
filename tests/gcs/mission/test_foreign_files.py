"""Files from others: nothing outside of a mission's folder or of a log is opened, nothing hangs, sizes are bounded."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from estimation.input_file import toml_content
from estimation.profile.profile import ProfileError, ProfileLibrary
from gcs.errors import InputError
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Run
from gcs.flightlog.run import mission_of
from gcs.mission.file import MissionError, load_mission, parse_mission
from gcs.vehicle_logs.foreign import is_foreign, read_vehicle_logs
from tests.support.flight_logs import engaging, record_simulation, rewrite
from tests.support.mission_text import CASE2
from tests.support.paths import PROFILES

REFUSED_WITHIN_S = 1.0
OWN = (PROFILES / "stub.toml").read_text(encoding="utf-8")


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Fail if what is inside takes longer, also where it hangs; processor time, so that a busy computer is no fault."""

    def end(*_: object) -> None:
        pytest.fail(f"it takes more than {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, 20.0 * seconds)
    began_s = time.process_time()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert time.process_time() - began_s < seconds


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    path = tmp_path / "pipe.toml"
    os.mkfifo(path)
    return path


@pytest.mark.parametrize("read", [read_log, read_vehicle_logs, lambda path: load_mission(str(path))])
def test_a_pipe_and_a_device_are_refused_at_once(read: Callable[[Path], object], pipe: Path) -> None:
    for path in (pipe, Path("/dev/zero"), pipe.parent):
        with within(REFUSED_WITHIN_S), pytest.raises(InputError, match="not a file"):
            read(path)
        assert not is_foreign(path)


@pytest.mark.parametrize("name", ["../own.toml", "{folder}/own.toml", "linked.toml", "pipe.toml", "/dev/zero"])
def test_a_profile_is_a_file_in_the_mission_s_folder_or_none(name: str, pipe: Path, tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    (inside / "linked.toml").symlink_to(tmp_path / "own.toml")
    pipe.rename(inside / "pipe.toml")
    with within(REFUSED_WITHIN_S), pytest.raises(ProfileError, match="no profile"):
        ProfileLibrary(inside).load(name.replace("{folder}", str(tmp_path)))
    (inside / "own.toml").write_text(OWN, encoding="utf-8")
    assert ProfileLibrary(inside).load("own.toml").plant == ProfileLibrary(None).load("stub").plant


def test_a_log_holds_its_profiles_and_no_file_takes_their_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    record_simulation(engaging("case2"), tmp_path / "log.mcap", duration_s=1.0)
    log = read_log(tmp_path / "log.mcap")
    text = CASE2.replace("[[vehicles]]", '[[vehicles]]\nprofile = "own.toml"', 1)
    assert parse_mission(text, tmp_path).vehicles[0].section.profile == "own.toml"

    def foreign(record: object) -> object:
        run = record.read(record.kind)  # type: ignore[attr-defined]
        if not isinstance(run, Run):
            return run
        fields = {name: getattr(run, name) for name in Run.__struct_fields__}
        return Run(**{**fields, "mission_text": text})

    with pytest.raises(LogError, match="the log does not hold it"):
        mission_of(rewrite(log, tmp_path / "foreign.mcap", 0, foreign))


CORNERS = ", ".join(f"[{i}.0, {i % 2}.5]" for i in range(10_000))
TOO_MUCH = {
    "fence of 10 000 corners": CASE2.replace("[safety]\n", f"[safety]\nfence_m = [{CORNERS}]\n"),
    "fence of 2 000 corners": CASE2.replace("[safety]\n", f"[safety]\nfence_m = [{CORNERS[:26_000]}]]\n"),
    "50 000 unknown keys": CASE2.replace("[safety]\n", "[safety]\n" + "".join(f"k{i} = 1\n" for i in range(50_000))),
    "8 000 unknown sections": CASE2 + "".join(f"[k{i}]\n" for i in range(8_000)),
    "5 000 vehicles": CASE2 + "[[vehicles]]\nid = 9\n" * 5_000,
    "a key of 50 000 parts": "a." * 50_000 + "a = 1",
    "quoted parts": '"a,".' * 20_000 + "a = 1",
    "a table of 50 000 parts": "[" + "a." * 50_000 + "a]",
}


@pytest.mark.parametrize("what", TOO_MUCH)
def test_a_mission_beyond_all_bounds_is_refused_in_a_second(what: str) -> None:
    with within(REFUSED_WITHIN_S), pytest.raises(MissionError) as refused:
        parse_mission(TOO_MUCH[what], None)
    assert len(refused.value.faults) <= 40, "they can be read"
    assert all(len(fault) < 400 for fault in refused.value.faults)


@pytest.mark.parametrize(
    "text",
    ['a = "x.' + "y." * 50 + '"', "a = '''" + "y." * 50 + "'''", "# " + "y." * 50, 'a = """' + '\\"y.' * 50 + '"""'],
)
def test_points_in_texts_and_comments_are_no_parts_of_keys(text: str) -> None:
    assert toml_content(f"{text}\nb.c = 1.5")["b"] == {"c": 1.5}
