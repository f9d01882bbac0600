"""The injected faults of one vehicle and its link, which are set and cleared during the run."""

from dataclasses import dataclass, field, fields

from estimation.frames import Triple


@dataclass(slots=True)
class VehicleFaults:
    """The injected faults of one vehicle; none by default.

    A cut link passes nothing in either direction; a delay [wall s] applies to each direction. With silent motion a
    vehicle sends everything except its position. An offset of the estimate, in the mission frame, also affects the
    autopilot, which flies to setpoints in its own estimate. A push is an acceleration in addition to the wind,
    `estimator_ratio` a lower bound of the test ratio of the horizontal position, `endurance_s` the reported flight time
    left (None: not reported), `second_battery` the charge of a second battery, a fraction (None: there is none). With
    `values_unknown` each value that may be unknown is reported as that; a silent battery is not reported. A
    `charge_state` replaces MAV_BATTERY_CHARGE_STATE_OK.

    `origin_moved_m` is how far the origin of its local NED has moved since boot, in the mission frame: it knows its
    place on Earth as well as before. `height_jump_m` is an offset of its height that its own tests do not show, as
    after a reset of the estimator; neither its barometer nor its GPS has it. `barometer_off_m` is an error of the
    barometer that the estimate follows. A silent gimbal does not report its attitude.
    """

    link_cut: bool = False
    link_delay_s: float = 0.0
    motion_silent: bool = False
    estimate_offset_m: Triple = (0.0, 0.0, 0.0)
    push_m_s2: tuple[float, float] = (0.0, 0.0)
    estimator_ratio: float = 0.0
    endurance_s: float | None = None
    second_battery: float | None = None
    values_unknown: bool = False
    battery_silent: bool = False
    charge_state: int = 1
    origin_moved_m: Triple = (0.0, 0.0, 0.0)
    height_jump_m: float = 0.0
    barometer_off_m: float = 0.0
    gimbal_silent: bool = False

    @property
    def unnoticed_m(self) -> float:
        """The offset of the estimate's height that its tests do not show."""
        return self.height_jump_m + self.barometer_off_m

    @property
    def offset_m(self) -> Triple:
        """The whole offset of the estimate."""
        x, y, z = self.estimate_offset_m
        return x, y, z + self.unnoticed_m

    def add(self, others: "VehicleFaults") -> None:
        """Add the other faults; their values replace those of the same fault."""
        for each in fields(self):
            if (value := getattr(others, each.name)) != each.default:
                setattr(self, each.name, value)

    def clear(self) -> None:
        """Clear all faults."""
        for each in fields(self):
            setattr(self, each.name, each.default)


@dataclass(frozen=True, slots=True)
class VehicleInjection:
    """An injection into a vehicle: additional faults, and the remaining share of its battery.

    With `selects_hold` its mode becomes hold, as if another ground station had selected it.
    """

    faults: VehicleFaults = field(default_factory=VehicleFaults)
    battery_fraction: float | None = None
    selects_hold: bool = False


def shifted(place_m: Triple, by_m: Triple) -> Triple:
    """Return a position shifted by an offset."""
    x, y, z = (place + by for place, by in zip(place_m, by_m, strict=True))
    return x, y, z
