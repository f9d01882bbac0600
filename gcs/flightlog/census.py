"""Counting the records of a log: how many there are, how long they last, and which are missing between them."""

from collections import defaultdict


class Census:
    """What has been seen of a log's records. Those of a vehicle are numbered, so that none can be missing unnoticed."""

    def __init__(self) -> None:
        self.records: defaultdict[int, int] = defaultdict(int)
        self.damaged = 0
        self._seen: dict[int, tuple[int, int]] = {}
        self._gaps: dict[int, _Gap] = {}
        self._first_ns: int | None = None
        self._last_ns = 0

    def note(self, vehicle_id: int, time_ns: int, payload: bytes) -> bool:
        """Count a record, encoded; vehicle 0 is the run as a whole. Return whether it is one."""
        if vehicle_id:
            number = _number(payload)
            if not number:
                self.damaged += 1
                return False
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
        """How many records there are."""
        return sum(self.records.values())

    @property
    def seconds(self) -> float:
        """How long they last, on the log's clock."""
        return (self._last_ns - (self._first_ns or 0)) / 1e9

    @property
    def faults(self) -> list[str]:
        """What is missing, in a line for each vehicle; times count from the log's first record."""
        damaged = [f"{self.damaged} records are damaged and left out"] if self.damaged else []
        return [*damaged, *(self._missing(vehicle_id, gap) for vehicle_id, gap in sorted(self._gaps.items()))]

    def _miss(self, vehicle_id: int, count: int, begin_ns: int, end_ns: int) -> None:
        gap = self._gaps.setdefault(vehicle_id, _Gap(begin_ns, end_ns))
        gap.places += 1
        gap.end_ns = max(gap.end_ns, end_ns)
        if count > 0:
            gap.missing += count
        else:
            gap.disordered += 1

    def _missing(self, vehicle_id: int, gap: "_Gap") -> str:
        first_ns = self._first_ns or 0
        begin_s, end_s = max(gap.begin_ns - first_ns, 0) / 1e9, max(gap.end_ns - first_ns, 0) / 1e9
        order = f", {gap.disordered} are out of order" if gap.disordered else ""
        places = f" in {gap.places} places" if gap.places > 1 else ""
        when = f"between {begin_s:.1f} and {end_s:.1f} s of the log"
        return f"vehicle {vehicle_id}: {gap.missing} records are missing{places}{order}, {when}"


class _Gap:
    """What is missing of a vehicle's records, and between when and when."""

    def __init__(self, begin_ns: int, end_ns: int) -> None:
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.missing = 0
        self.disordered = 0
        self.places = 0


def _number(payload: bytes) -> int:
    """Return the number of a record, its field 1, as Protobuf writes it: quicker than decoding all; 0 if none."""
    if payload[:1] != b"\x08":
        return 0
    value = shift = 0
    for byte in payload[1:11]:
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value
        shift += 7
    return 0
