"""Runs an emulated radio until Ctrl-C, with its counts on a terminal."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.live import Live

from gcs.console.terminal import STDERR
from gcs.radio.emulation import Emulation, run
from gcs.radio.view import counts_json, counts_table
from gcs.signals import pending


def serve_until_ctrl_c(emulations: Sequence[Emulation]) -> str:
    """Run radios until SIGINT or SIGTERM; return their counts as JSON."""
    began_s = time.monotonic()
    try:
        with Live(console=STDERR, auto_refresh=False, transient=True) as live:

            def show() -> None:
                if STDERR.is_terminal:
                    live.update(counts_table(emulations, time.monotonic() - began_s), refresh=True)

            run(emulations, pending, show)
    finally:
        for each in emulations:
            each.close()
    duration_s = time.monotonic() - began_s
    STDERR.print(counts_table(emulations, duration_s))
    return counts_json(emulations, duration_s)


@contextmanager
def running_beside(emulations: Sequence[Emulation]) -> Iterator[None]:
    """Run radios in a separate thread inside this context; print their counts at the end."""
    ended, began_s = threading.Event(), time.monotonic()
    thread = threading.Thread(target=run, args=(emulations, ended.is_set, lambda: None), name="radio", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        for each in emulations:
            each.close()
        STDERR.print(counts_table(emulations, time.monotonic() - began_s))
