"""A computer that runs short, and its clock, by another account of them than the library's."""

import ctypes
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from agents.shell import computer
from agents.shell.computer import ComputerClock, computer_clock, short_of
from tests.support.paths import ROOT


def test_nothing_is_short_within_limits_and_both_are_reported_below(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "flight.mcap"
    disk = os.statvfs(tmp_path)
    free_bytes = disk.f_bavail * disk.f_frsize
    monkeypatch.setattr(computer, "MEMORY_SHARE_MIN", 0.0)
    monkeypatch.setattr(computer, "DISK_MIN_BYTES", free_bytes - 100e6)
    assert short_of(log) == ""
    monkeypatch.setattr(computer, "DISK_MIN_BYTES", free_bytes + 100e6)
    assert "MB of disk" in short_of(log)
    assert short_of(None) == ""
    monkeypatch.setattr(computer, "MEMORY_SHARE_MIN", 1.0)
    total_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    assert f"of {total_mb:.0f} MB of memory" in short_of(log)
    assert "disk" in short_of(log)


def test_a_missing_folder_raises_no_exception(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computer, "MEMORY_SHARE_MIN", 0.0)
    assert short_of(tmp_path / "gone" / "flight.mcap") == ""


SHORT_OF_DESCRIPTORS = """
import resource, socket
from agents.shell.computer import allow_descriptors, short_of
resource.setrlimit(resource.RLIMIT_NOFILE, (100, 200))
allow_descriptors()
allow_descriptors()
assert resource.getrlimit(resource.RLIMIT_NOFILE) == (200, 200)
assert "descriptors" not in short_of(None)
held = [socket.socket() for _ in range(165)]
print(short_of(None))
try:
    while True:
        held.append(socket.socket())
except OSError:
    print(short_of(None))
"""


def test_a_process_takes_all_descriptors_that_it_may_and_says_when_they_run_out() -> None:
    said = subprocess.run(
        [sys.executable, "-c", SHORT_OF_DESCRIPTORS], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert re.search(r"1[67]\d of 200 descriptors of files and connections in use", said[0])
    assert "200 of 200 descriptors" in said[1]


@pytest.mark.skipif(sys.platform != "linux" or struct.calcsize("l") != 8, reason="the layout is that of 64-bit Linux")
def test_the_clock_is_as_the_kernel_says() -> None:
    raw = ctypes.create_string_buffer(512)
    ctypes.CDLL(None).adjtimex(raw)
    (error_us,) = struct.unpack_from("q", raw, 24)  # after modes, offset and frequency
    (status,) = struct.unpack_from("i", raw, 40)
    clock = computer_clock()
    assert clock is not None
    if status & 0x40:
        assert clock == ComputerClock(None)
    else:
        assert clock.error_s == pytest.approx(error_us * 1e-6, abs=0.01)
