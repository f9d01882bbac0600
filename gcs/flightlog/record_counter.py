"""Counts a log's records: their number, their duration, and those missing between them."""

from collections import defaultdict


class RecordCounter:
    """The counts of a log's records. Records of vehicles and bus messages are numbered, so gaps show missing ones."""

    def __init__(self) -> None:
        self.records: defaultdict[int, int] = defaultdict(int)
        self.damaged = 0
        self._seen: dict[int, tuple[int, int]] = {}
        self._missing_ranges: dict[int, _MissingRange] = {}
        self._first_ns: int | None = None
        self._last_ns = 0

    def note(self, vehicle_id: int, time_ns: int, payload: bytes) -> bool:
        """Count an encoded record; vehicle 0 is the run as a whole. Return whether it is undamaged."""
        number = _number(payload)
        if vehicle_id and not number:
            self.damaged += 1
            return False
        if number:
            last, last_ns = self._seen.get(vehicle_id, (0, time_ns))
            if number != last + 1:
                self._miss(vehicle_id, number - last - 1, last_ns, time_ns)
            self._seen[vehicle_id] = number, time_ns
        if self._first_ns is None:
            self._first_ns = time_ns
        self._last_ns = max(self._last_ns, time_ns)
        self.records[vehicle_id] += 1
        return True

    @property
    def total(self) -> int:
        """The number of records."""
        return sum(self.records.values())

    @property
    def seconds(self) -> float:
        """The duration on the log's clock [s]."""
        return (self._last_ns - (self._first_ns or 0)) / 1e9

    @property
    def faults(self) -> list[str]:
        """The missing records, in a line per vehicle; times count from the log's first record."""
        damaged = [f"{self.damaged} records are damaged and left out"] if self.damaged else []
        return [
            *damaged,
            *(
                self._missing(vehicle_id, missing_range)
                for vehicle_id, missing_range in sorted(self._missing_ranges.items())
            ),
        ]

    def _miss(self, vehicle_id: int, count: int, begin_ns: int, end_ns: int) -> None:
        missing_range = self._missing_ranges.setdefault(vehicle_id, _MissingRange(begin_ns, end_ns))
        missing_range.places += 1
        missing_range.end_ns = max(missing_range.end_ns, end_ns)
        if count > 0:
            missing_range.missing += count
        else:
            missing_range.disordered += 1

    def _missing(self, vehicle_id: int, missing_range: "_MissingRange") -> str:
        first_ns = self._first_ns or 0
        begin_s, end_s = max(missing_range.begin_ns - first_ns, 0) / 1e9, max(missing_range.end_ns - first_ns, 0) / 1e9
        order = f", {missing_range.disordered} are out of order" if missing_range.disordered else ""
        places = f" in {missing_range.places} places" if missing_range.places > 1 else ""
        when = f"between {begin_s:.1f} and {end_s:.1f} s of the log"
        whose = f"vehicle {vehicle_id}" if vehicle_id else "messages of the bus"
        return f"{whose}: {missing_range.missing} records are missing{places}{order}, {when}"


class _MissingRange:
    """The number of a vehicle's missing records, and the times between which they are missing."""

    def __init__(self, begin_ns: int, end_ns: int) -> None:
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.missing = 0
        self.disordered = 0
        self.places = 0


def _number(payload: bytes) -> int:
    """Return the number of a record, field 1 of its Protobuf encoding, 0 if none: quicker than decoding the record."""
    if payload[:1] != b"\x08":
        return 0
    value = shift = 0
    for byte in payload[1:11]:
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value
        shift += 7
    return 0
