"""The animation of a flight: each vehicle is where it was, the file is small, and it plays to the flight's end."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from gcs.metrics.ring import ring_motion
from gcs.report import animation
from gcs.report.animation import save_animation
from gcs.report.charts.panels import Sheet
from gcs.style import COLOURS
from tests.support.report_evidence import flown

pytestmark = pytest.mark.slow

FRAMES_MAX, FRAMES = animation.FRAMES_MAX, 6
BODY_PX = 5
"""A square of this size lies within a vehicle's mark, and not within the line of its path."""


@pytest.fixture(scope="module")
def sheet() -> Sheet:
    evidence, result, criteria = flown(3, duration_s=120.0, rate_hz=2.0)
    return Sheet(evidence.record, result, criteria.ring, None, ring_motion(evidence.record))


def body_px(picture: Image.Image, colour: str) -> NDArray[np.float64]:
    """Return the middle (x, y) of the mark of a colour in a picture."""
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
    near = (np.abs(np.asarray(picture.convert("RGB"), dtype=int) - wanted) < 40).all(axis=2)
    windows = np.lib.stride_tricks.sliding_window_view(near, (BODY_PX, BODY_PX)).all(axis=(2, 3))
    rows, columns = np.nonzero(windows)
    return np.array([columns.mean(), rows.mean()])


@pytest.mark.parametrize("name", ["flight.gif", "flight.WEBP"])
def test_vehicles_are_where_they_were_at_the_beginning_and_the_end(
    tmp_path: Path, sheet: Sheet, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(animation, "FRAMES_MAX", FRAMES)
    path, shares = tmp_path / name, list[float]()
    save_animation(sheet, path, shares.append)
    assert path.stat().st_size < 2_000_000 * FRAMES / FRAMES_MAX
    assert shares == sorted(shares)
    assert len(shares) == FRAMES
    with Image.open(path) as drawn:
        assert drawn.format == name.split(".")[1].upper()
        scales = []
        for frame, sample in ((0, 0), (FRAMES - 1, -1)):
            drawn.seek(frame)
            places_px = [body_px(drawn, COLOURS[row]) for row in range(3)]
            places_m = [track.position_m[sample] for track in sheet.record.vehicles]
            for one, other in ((0, 1), (0, 2), (1, 2)):
                apart_px, apart_m = places_px[one] - places_px[other], places_m[one] - places_m[other]
                scales.append(np.hypot(*apart_px) / np.hypot(*apart_m))
                # Up in the picture is up on the map.
                assert apart_px @ (apart_m * [1.0, -1.0]) == pytest.approx(
                    np.hypot(*apart_px) * np.hypot(*apart_m), rel=0.02
                )
        assert scales == pytest.approx([scales[0]] * len(scales), rel=0.05)


def test_a_short_flight_has_a_frame_for_each_of_its_times(tmp_path: Path) -> None:
    evidence, result, criteria = flown(1, duration_s=2.0, rate_hz=2.0)
    sheet = Sheet(evidence.record, result, criteria.ring, None, ring_motion(evidence.record))
    shares = list[float]()
    save_animation(sheet, tmp_path / "short.gif", shares.append)
    assert len(shares) == evidence.record.time_s.size == 5
