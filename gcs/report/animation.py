"""A flight from above as a short animation (GIF or WebP): paths, vehicles, target, ring, and mission time."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estimation.state import Vector
from gcs.keys.private_files import create
from gcs.report.charts.panels import Sheet, landmarks_m, map_height_in, name_ring, ring_label
from gcs.style import DESIRED, ENGAGED, FAINT, INK, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL.Image import Image as Picture

SUFFIXES = (".gif", ".webp")
FRAMES_MAX = 150
_FRAME_MS, _LAST_FRAME_MS = 80, 2500
_WIDTH_IN, _DPI = 8.0, 100
_GIF_COLOURS = 64
_RECENT_SHARE = 0.1
"""The path of this share of the flight is drawn in full colour, what is older is faint."""
_ANGLES_RAD = np.linspace(0.0, 2.0 * np.pi, 121)
_CIRCLE = np.column_stack((np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)))


def save_animation(sheet: Sheet, path: Path, progress: Callable[[float], None]) -> None:
    """Draw a flight from above and write it to `path`, whose suffix chooses GIF or WebP.

    `progress` is called with the share that is done. The record holds at least two times and a vehicle. Raises OSError
    when the file cannot be written.
    """
    with drawing():
        scene = _Scene(sheet)
        last = sheet.record.time_s.size - 1
        samples = np.unique(np.linspace(0, last, FRAMES_MAX).round().astype(int)).tolist()
        frames = []
        for index, sample in enumerate(samples):
            frames.append(scene.frame(sample))
            progress(index / len(samples))
    _write(frames, path)


def _write(frames: "list[Picture]", path: Path) -> None:
    from PIL import Image  # noqa: PLC0415

    durations_ms = [*(_FRAME_MS for _ in frames[1:]), _LAST_FRAME_MS]
    suffix = path.suffix.lower()
    if suffix == ".gif":
        # One palette for all frames: between them only what moves differs. The last frame holds every colour.
        palette = frames[-1].quantize(_GIF_COLOURS)
        frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    options = {"duration": durations_ms, "loop": 0, "quality": 75, "method": 4}
    with create(path) as file:
        frames[0].save(file, suffix[1:], save_all=True, append_images=frames[1:], **options)


class _Scene:
    """The figure of all frames: what never changes, and what each frame moves."""

    def __init__(self, sheet: Sheet) -> None:
        self._sheet = sheet
        self._canvas, axes = _empty_map(sheet)
        rows = range(len(sheet.record.vehicles))
        self._paths = [axes.plot([], [], alpha=0.35, **sheet.style(row))[0] for row in rows]
        self._recent = [axes.plot([], [], **sheet.style(row))[0] for row in rows]
        self._targets = [_Target(axes, path_m) for path_m in sheet.record.target_paths_m]
        self._rings = [_Ring(axes, each) for each in sheet.each_ring]
        self._bodies = [
            _Body(axes, sheet.colour(row), track.vehicle_id) for row, track in enumerate(sheet.record.vehicles)
        ]
        self._clock = axes.set_title("", loc="right", color=INK)

    def frame(self, sample: int) -> "Picture":
        """Return the picture of the flight at one time."""
        from PIL import Image  # noqa: PLC0415

        record = self._sheet.record
        now_s = float(record.time_s[sample])
        since = max(0, sample - round(_RECENT_SHARE * record.time_s.size))
        for target in self._targets:
            target.move(sample)
        at_m: dict[tuple[float, float], list[_Ring]] = {}
        for ring in self._rings:
            ring.move(sample)
            at_m.setdefault(ring.top_m, []).append(ring)
        for first, *others in at_m.values():  # rings above each other have one label
            first.write(", ".join(each.label for each in (first, *others)))
            for each in others:
                each.write("")
        engaged_s = [vehicle.engaged_at_s for vehicle in self._sheet.result.vehicles]
        for row, track in enumerate(record.vehicles):
            self._paths[row].set_data(*track.position_m[: since + 1].T)
            self._recent[row].set_data(*track.position_m[since : sample + 1].T)
            self._bodies[row].move(track.position_m[sample])
            each_s = engaged_s[row]
            if each_s is not None and each_s <= now_s:
                self._bodies[row].engage(track.position_m[int(np.argmin(np.abs(record.time_s - each_s)))])
        self._clock.set_text(f"mission time {now_s:.0f} of {record.time_s[-1]:.0f} s")
        drawn, size = self._canvas.print_to_buffer()  # type: ignore[no-untyped-call]
        return Image.frombytes("RGBA", size, drawn).convert("RGB")


class _Target:
    """A target on the map, with its path."""

    def __init__(self, axes: "Axes", path_m: Vector) -> None:
        self._path_m = path_m
        self._path = axes.plot([], [], color="black", linewidth=1.0, zorder=3)[0]
        self._mark = axes.plot([], [], "D", color="black", markersize=8, zorder=6)[0]

    def move(self, sample: int) -> None:
        """Show it at a time."""
        self._path.set_data(*self._path_m[: sample + 1].T)
        self._mark.set_data(*self._path_m[sample : sample + 1].T)


class _Ring:
    """A ring on the map from its first engagement on, with its name if there are several."""

    def __init__(self, axes: "Axes", sheet: Sheet) -> None:
        self._sheet, self._target_m, self._desired_m = sheet, sheet.record.target_path_m, sheet.desired_m
        engaged_s = (vehicle.engaged_at_s for vehicle in sheet.result.vehicles)
        self._begins_s = min((each for each in engaged_s if each is not None), default=np.inf)
        self._circle = axes.plot([], [], **DESIRED)[0]
        self.label = ring_label(sheet) if sheet.name else ""
        self.top_m = (np.nan, np.nan)
        """Its highest point on the map, not a number while it is not shown."""
        self._name = name_ring(axes, (0.0, 0.0), self.label)

    def move(self, sample: int) -> None:
        """Show it at a time."""
        is_shown = bool(
            self._begins_s <= self._sheet.record.time_s[sample] and np.isfinite(self._target_m[sample]).all()
        )
        circle_m = self._target_m[sample] + self._desired_m[sample] * _CIRCLE
        self._circle.set_data(*circle_m.T if is_shown else ([], []))
        self._name.set_visible(is_shown)
        self.top_m = (np.nan, np.nan)
        if is_shown:
            x, y = self._target_m[sample].tolist()
            self._name.xy = self.top_m = x, y + float(self._desired_m[sample])

    def write(self, text: str) -> None:
        """Write a text above it."""
        self._name.set_text(text)


class _Body:
    """A vehicle on the map with its id, and the mark of where it engaged."""

    def __init__(self, axes: "Axes", colour: str, vehicle_id: int) -> None:
        self._mark = axes.plot([], [], "D", markersize=12, color=colour, markeredgecolor="white", zorder=7)[0]
        self._engaged = axes.plot([], [], color=colour, zorder=5, linestyle="", **ENGAGED)[0]
        self._name = axes.text(0.0, 0.0, str(vehicle_id), ha="center", va="center_baseline", fontsize=8, zorder=8)
        self._name.set(color="white", fontweight="bold")

    def move(self, place_m: Vector) -> None:
        """Show the vehicle at a place (2,), NaN where it is not known."""
        is_known = bool(np.isfinite(place_m).all())
        self._mark.set_data(*([each] for each in place_m))
        self._name.set_visible(is_known)
        if is_known:
            self._name.set_position(tuple(place_m))

    def engage(self, place_m: Vector) -> None:
        """Mark where (2,) the vehicle engaged."""
        self._engaged.set_data(*([each] for each in place_m))


def _empty_map(sheet: Sheet) -> "tuple[FigureCanvasAgg, Axes]":
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    points_m = landmarks_m(sheet)
    figure = Figure(figsize=(_WIDTH_IN, map_height_in(points_m, _WIDTH_IN) + 0.3), dpi=_DPI, layout="tight")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.update_datalim(points_m)
    axes.margins(0.04)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.tick_params(colors=FAINT, labelcolor=INK)
    axes.set_title(sheet.record.mission, loc="left", fontweight="bold", parse_math=False)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once: every frame has the same map at the same place
    axes.set_autoscale_on(False)
    axes.set_aspect("auto")  # with these limits it is equal
    return canvas, axes
