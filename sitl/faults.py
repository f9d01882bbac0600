"""What may be wrong with one vehicle and its link: set, and taken back, while the vehicle is served."""

from dataclasses import dataclass, field, fields

from estimation.frames import Triple


@dataclass(slots=True)
class VehicleFaults:
    """The injected faults of one vehicle; none by default.

    With its link cut nothing passes in either direction; a delay [wall s] is that of each direction. A vehicle whose
    motion is silent tells everything but where it is. An estimate that is off by an offset in the mission frame is off
    for the autopilot as well: it flies to the setpoint in its own estimate. A push is an acceleration beside the wind,
    `estimator_ratio` the test ratio of the horizontal position at the least, `endurance_s` the flight time left that
    the battery reports (none: it reports none).
    """

    link_cut: bool = False
    link_delay_s: float = 0.0
    motion_silent: bool = False
    estimate_offset_m: Triple = (0.0, 0.0, 0.0)
    push_m_s2: tuple[float, float] = (0.0, 0.0)
    estimator_ratio: float = 0.0
    endurance_s: float | None = None

    def add(self, others: "VehicleFaults") -> None:
        """Have the others as well; of one that both have, the others' value counts."""
        for each in fields(self):
            if (value := getattr(others, each.name)) != each.default:
                setattr(self, each.name, value)

    def clear(self) -> None:
        """Have none."""
        for each in fields(self):
            setattr(self, each.name, each.default)


@dataclass(frozen=True, slots=True)
class VehicleInjection:
    """What is injected into a vehicle: faults beside those that it has, the and the share of its battery that is left.

    With `selects_hold` its mode becomes hold, as if another ground station had selected it.
    """

    faults: VehicleFaults = field(default_factory=VehicleFaults)
    battery_fraction: float | None = None
    selects_hold: bool = False


def shifted(place_m: Triple, by_m: Triple) -> Triple:
    """Return a place moved by an offset."""
    x, y, z = (place + by for place, by in zip(place_m, by_m, strict=True))
    return x, y, z
