"""Units of quantities, by the end of their names."""

_UNITS = {
    "m": "m",
    "m2": "m²",
    "m_s": "m/s",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "rad": "rad",
    "rad_s": "rad/s",
    "deg": "°",
    "deg_s": "°/s",
    "s": "s",
    "us": "µs",
    "hz": "Hz",
    "per_s": "1/s",
    "per_s2": "1/s²",
    "bytes_per_s": "bytes/s",
    "percent": "%",
    "sigma": "σ",
    "sigmas": "σ",
}


def unit(name: str) -> str:
    """Return the unit that a name ends with, empty where it has none; the longest end that fits counts."""
    ends = [end for end in _UNITS if f"_{name}".endswith(f"_{end}")]
    return _UNITS[max(ends, key=len)] if ends else ""
