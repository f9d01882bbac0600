"""A computer that runs short, by another account of it than the library's."""

import os
from pathlib import Path

import pytest

from agents.shell import computer
from agents.shell.computer import short_of


def test_nothing_is_short_of_where_limits_are_met_and_both_are_told_where_not(
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


def test_a_folder_that_is_gone_is_no_exception(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computer, "MEMORY_SHARE_MIN", 0.0)
    assert short_of(tmp_path / "gone" / "flight.mcap") == ""
