"""The names of flight modes, and the modes in which a computer's position setpoints control the vehicle."""

from types import MappingProxyType

CORDON = "cordon"
"""Flown by cordon itself, in its own log."""
EXTERNAL = frozenset({"offboard", "guided", CORDON})

PX4_STATES = MappingProxyType(
    {
        0: "manual",
        1: "altitude",
        2: "position",
        3: "mission",
        4: "hold",
        5: "return",
        6: "position slow",
        10: "acro",
        12: "descend",
        13: "termination",
        14: "offboard",
        15: "stabilized",
        17: "take-off",
        18: "land",
        19: "follow target",
        20: "precision land",
        21: "orbit",
        22: "vtol take-off",
    }
)
"""PX4's navigation states, as its log numbers them."""

PX4_MODES = MappingProxyType(
    {
        (1, 0): "manual",
        (2, 0): "altitude",
        (3, 0): "position",
        (3, 1): "orbit",
        (4, 1): "ready",
        (4, 2): "take-off",
        (4, 3): "hold",
        (4, 4): "mission",
        (4, 5): "return",
        (4, 6): "land",
        (4, 8): "follow target",
        (4, 9): "precision land",
        (4, 10): "vtol take-off",
        (5, 0): "acro",
        (6, 0): "offboard",
        (7, 0): "stabilized",
        (10, 0): "termination",
    }
)
"""PX4's (main mode, sub mode), as its heartbeats number them."""

COPTER_MODES = MappingProxyType(
    {
        0: "stabilize",
        1: "acro",
        2: "alt hold",
        3: "auto",
        4: "guided",
        5: "loiter",
        6: "return",
        7: "circle",
        9: "land",
        11: "drift",
        13: "sport",
        14: "flip",
        15: "autotune",
        16: "poshold",
        17: "brake",
        18: "throw",
        19: "avoid adsb",
        20: "guided nogps",
        21: "smart return",
        22: "flowhold",
        23: "follow",
        24: "zigzag",
        25: "system id",
        26: "autorotate",
        27: "auto return",
        28: "turtle",
        29: "rate acro",
    }
)
"""ArduCopter's mode numbers, in its log and its heartbeats alike."""


def px4_state(number: int) -> str:
    """Return the name of a navigation state of PX4."""
    return PX4_STATES.get(number, f"state {number}")


def px4_mode(custom_mode: int) -> str:
    """Return the name of a mode in a heartbeat of PX4."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    return PX4_MODES.get((main, sub), f"mode {main}.{sub}")


def copter_mode(number: int) -> str:
    """Return the name of a mode of ArduCopter."""
    return COPTER_MODES.get(number, f"mode {number}")
