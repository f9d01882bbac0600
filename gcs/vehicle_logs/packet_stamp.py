"""The begin of a packet of a MAVLink telemetry log: its time stamp, then the first byte of a MAVLink frame."""

MAVLINK_MAGICS = (0xFD, 0xFE)
STAMP_BYTES = 8
STAMPS_US = range(946_684_800_000_000, 4_102_444_800_000_000)
"""Microseconds since 1970 from the year 2000 up to 2100: when a ground station may have stamped a packet."""
