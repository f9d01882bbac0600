"""The counts of an emulated radio, as a table and as JSON."""

from collections.abc import Sequence

from rich.table import Table

from gcs.metrics.json_output import json_output
from gcs.radio.emulation import Emulation
from sitl.radio.channel import Counts


def counts_json(emulations: Sequence[Emulation], duration_s: float) -> str:
    """Return the counts of both directions as one JSON object."""
    counts = {
        "duration_s": duration_s,
        "up": [_json(counts) for each in emulations for counts in each.up],
        "down": [_json(counts) for each in emulations for counts in each.down],
    }
    return json_output(counts)


def _json(counts: Counts) -> dict[str, int]:
    return {
        "frames": counts.sent_frames,
        "bytes": counts.sent_bytes,
        "lost": counts.lost_frames,
        "dropped": counts.dropped_frames,
    }


def counts_table(emulations: Sequence[Emulation], duration_s: float) -> Table:
    """Return the counts of both directions, and the mean bytes per second since the start."""
    table = Table(title="radio", title_style="bold")
    for column in ("direction", "connection"):
        table.add_column(column, overflow="fold")
    for column in ("frames", "bytes/s", "lost", "dropped"):
        table.add_column(column, justify="right")
    rows = [("to", place, counts) for each in emulations for place, counts in zip(each.groups, each.up, strict=True)]
    rows += [
        ("from", place, counts) for each in emulations for place, counts in zip(each.places, each.down, strict=True)
    ]
    for direction, place, counts in rows:
        rate = counts.sent_bytes / duration_s if duration_s else 0.0
        numbers = (counts.sent_frames, round(rate), counts.lost_frames, counts.dropped_frames)
        table.add_row(direction, place, *map(str, numbers))
    return table
