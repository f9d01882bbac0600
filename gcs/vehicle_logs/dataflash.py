"""ArduPilot's own log (.bin), with pymavlink's description of its formats.

pymavlink describes the formats; this module cuts the records. `DFReader_binary` of pymavlink 2.4.50 takes 64 ms for a
log that this module reads in 1.2 ms. Its C indexer writes to the terminal past any redirection (2 million lines for
2 MB of zeros), drops most records when one format has the length 0, and raises for an unknown format letter.
"""

from collections import defaultdict
from collections.abc import Sequence
from math import isfinite, pi
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.DFReader import DFFormat, null_term

from estimation.frames import Geodetic, MissionFrame, up_from_ned
from estimation.state import Vector
from gcs.autopilots.ardupilot import AUTOPILOT
from gcs.flightlog.container import LogError
from gcs.vehicle_logs.log_file import LogFile
from gcs.vehicle_logs.raw_log import REACH_MAX_M, US, RawLog, Samples, longest_boot, stamps_us, vehicle_log
from gcs.vehicle_logs.vehicle_log import VehicleLog

FORMAT = "ArduPilot log (.bin)"
HEAD = b"\xa3\x95"
HEADER_BYTES = 3
FMT, FMT_BYTES = 0x80, 89
BLOCK_BYTES = 528
"""Most padding at the end of a log, which is written in blocks."""

SETPOINT, OLD_SETPOINT = "GUIP", "GUID"
"""The log of guided targets, and its name before Copter 4.2, which stated metres for its centimetres."""
ESTIMATORS = {3: "XKF", 2: "NKF"}
"""The names of an estimator's logs by its number in AHRS_EKF_TYPE."""
ESTIMATE = "XKF1"
LOCATED, POSITIONED = (1, 2), (1, 2, 3)
"""Guided submodes with a position setpoint: waypoint, position, trajectory. Targets in latitude and longitude ("fly
here") are logged as of the first two. Before Copter 4.1 the second was that of velocities, with zeros as position.
"""
FED = 3
"""The submode that feeds the setpoint's velocity forward."""
PLACES_MAX = (90e7, 180e7)
"""The largest latitude and longitude, in the unit of such targets."""
EVENTS = MappingProxyType({10: True, 11: False})
WANTED = frozenset(
    {"FMTU", "UNIT", "MULT", "PARM", "MSG", "MODE", "VER", "EV", "ARM", "ORGN", "BAT", "ATT", "SIM", "SIM2"}
    | {SETPOINT, OLD_SETPOINT}
    | {f"{estimator}{number}" for estimator in ESTIMATORS.values() for number in (1, 4)}
)
DEFINING = ("FMTU", "UNIT", "MULT")
STAMPED = ("TimeUS",)
NAMED_FACTORS = (("cm", 0.01), ("mm", 0.001), ("m", 1.0))

Row = dict[str, Any]
Table = dict[str, Any]


class _Records:
    """The records of the needed types: where each begins, and each type's format."""

    def __init__(self, log: LogFile) -> None:
        self._data = log.content()
        self._offsets: defaultdict[str, list[int]] = defaultdict(list)
        self._formats: dict[str, Any] = {}
        self.notes = log.notes
        self.is_damaged = False
        self._cut()
        self._keep_one_boot()
        self._read_units()

    def table(self, name: str) -> Table:
        """Return all records of a type as columns, in SI where the format itself has a factor; empty without any."""
        offsets, form = self._offsets.get(name, []), self._formats.get(name)
        if not offsets or form is None:
            return {}
        rows = np.array(offsets)[:, np.newaxis] + np.arange(HEADER_BYTES, form.len)
        records = np.frombuffer(self._data, dtype=np.uint8)[rows].tobytes()
        table = np.frombuffer(records, dtype=_dtype(form))
        return {
            column: table[column] * factor if factor is not None else table[column]
            for column, factor in zip(form.columns, form.msg_mults, strict=True)
        }

    def first(self, *names: str) -> str | None:
        """Return the first of these types that has records; None without any."""
        return next((name for name in names if self._offsets.get(name) and name in self._formats), None)

    def unit(self, name: str, column: str) -> str:
        """Return the unit that the log states for a column; empty if none."""
        form = self._formats[name]
        return str(form.get_unit(column)) if form.units is not None else ""

    def _cut(self) -> None:
        """Find where records begin; other bytes, and records that run into them, are skipped up to the next header."""
        data, end, at = self._data, len(self._data), 0
        lengths: dict[int, int] = {FMT: FMT_BYTES}
        kept: dict[int, list[int]] = {}
        bad = 0
        while at + HEADER_BYTES <= end:
            kind = data[at + 2]
            length = lengths.get(kind, 0) if data.startswith(HEAD, at) else 0
            if not length or (at + length <= end and not self._is_followed(at + length)):
                found = data.find(HEAD, at + 1)
                skipped = (found if found >= 0 else end) - at
                bad += skipped if end - at > BLOCK_BYTES or found >= 0 else 0
                at += skipped
                continue
            if at + length > end:
                self.notes.append(f"ends in the middle of a record at byte {at}")
                break
            if kind == FMT:
                self._define(data[at + HEADER_BYTES : at + length], lengths, kept)
            elif kind in kept:
                kept[kind].append(at)
            at += length
        if bad:
            self.is_damaged = True
            self.notes.append(f"damaged: {bad} bytes were skipped")

    def _is_followed(self, at: int) -> bool:
        """Return whether a record begins here, or the log ends, perhaps with a block that is not full."""
        if self._data.startswith(HEAD, at):
            return True
        return len(self._data) - at <= BLOCK_BYTES and self._data.find(HEAD, at) < 0

    def _keep_one_boot(self) -> None:
        """Keep the records of the longest boot, if the autopilot restarted."""
        tables = {name: table for name in self._offsets if "TimeUS" in (table := self.table(name))}
        if not tables:
            return
        offsets = np.concatenate([self._offsets[name] for name in tables])
        order = np.argsort(offsets)
        stamps = np.concatenate([stamps_us(table["TimeUS"]) for table in tables.values()])[order]
        first, last = longest_boot(stamps, self.notes)
        begin = offsets[order[first]] if first else 0
        end = offsets[order[last]] if last < order.size else len(self._data)
        for name in set(self._offsets) - set(DEFINING):
            self._offsets[name] = [at for at in self._offsets[name] if begin <= at < end]

    def _define(self, body: bytes, lengths: dict[int, int], kept: dict[int, list[int]]) -> None:
        """Store a type's first format. The records of an inconsistent one are skipped."""
        kind, length = body[0], body[1]
        name, letters, columns = (null_term(part) for part in (body[2:6], body[6:22], body[22:86]))
        if kind in lengths:
            return
        try:
            form = DFFormat(kind, name, length, letters, columns)
            dtype = _dtype(form)
            fits = dtype.itemsize == length - HEADER_BYTES
            form = form if dtype.names == tuple(form.columns) else None  # numpy names a column without a name itself
        except Exception:  # for an unknown format letter pymavlink raises plain Exception
            form, fits = None, length > HEADER_BYTES
        if fits:
            lengths[kind] = length
        if fits and form is not None and name in WANTED and name not in self._formats:
            self._formats[name] = form
            kept[kind] = self._offsets[name]
        elif name in WANTED:
            self.is_damaged = True
            self.notes.append(f"the format of {name} is inconsistent: its records were skipped")

    def _read_units(self) -> None:
        units = {row["Id"]: null_term(row["Label"]) for row in self.rows("UNIT", "Id", "Label")}
        factors = {row["Id"]: float(f"{row['Mult']:.7g}") for row in self.rows("MULT", "Id", "Mult")}
        named = {chr(key): unit for key, unit in units.items() if key in range(128)}
        scaled = {chr(key): factor for key, factor in factors.items() if key in range(128)}
        by_kind = {form.type: form for form in self._formats.values()}
        for row in self.rows("FMTU", "FmtType", "UnitIds", "MultIds"):
            form = by_kind.get(row["FmtType"])
            unit_ids, factor_ids = null_term(row["UnitIds"]), null_term(row["MultIds"])
            if form is not None and len(unit_ids) == len(factor_ids) == len(form.columns):
                form.set_unit_ids(unit_ids, named)
                form.set_mult_ids(factor_ids, scaled)

    def rows(self, name: str, *needed: str) -> list[Row]:
        """Return all records of a type; none, and a note, if it lacks a needed column."""
        table = self.table(name)
        lacking = [column for column in needed if column not in table]
        if table and lacking:
            self.notes.append(f"{name} has no {', '.join(lacking)}: left out")
        if not table or lacking:
            return []
        columns = [column.tolist() for column in table.values()]
        return [dict(zip(table, values, strict=True)) for values in zip(*columns, strict=True)]


def _dtype(form: Any) -> np.dtype[Any]:
    letters = form.msg_struct[1:]
    kinds = {"b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"}
    kinds |= {"e": "<f2", "f": "<f4", "d": "<f8", "4s": "S4", "16s": "S16", "64s": "S64"}
    types, size = [], ""
    for letter in letters:
        size += letter
        if not letter.isdigit():
            types.append(kinds[size])
            size = ""
    return np.dtype(list(zip(form.columns, types, strict=True)))


def read(log: LogFile) -> tuple[VehicleLog, ...]:
    """Return the one vehicle's log; raises LogError when it cannot be read as one."""
    records = _Records(log)
    raw = RawLog(
        path=log.name,
        format=FORMAT,
        sha256=log.sha256,
        autopilot=AUTOPILOT.name,
        notes=records.notes,
        is_damaged=records.is_damaged,
    )
    raw.parameters.update(_parameters(records))
    raw.system_id = int(raw.parameters.get("MAV_SYSID", raw.parameters.get("SYSID_THISMAV", 0)))
    raw.firmware = next((_text(row, "FWS") for row in records.rows("VER", "FWS")), "")
    _add_estimate(raw, records)
    _add_setpoints(raw, records)
    _add_truth(raw, records)
    _add_battery(raw, records)
    _add_modes(raw, records)
    raw.texts += [(int(row["TimeUS"]), None, _text(row, "Message")) for row in records.rows("MSG", *STAMPED, "Message")]
    if not raw.samples and not raw.modes:
        raise LogError([f"{log.name}: it holds none of the messages {ESTIMATE}, {SETPOINT}, MODE"])
    return (vehicle_log(raw),)


def _text(row: Row, name: str) -> str:
    return str(null_term(row.get(name, b""))).strip()


def _parameters(records: _Records) -> dict[str, float]:
    rows = records.rows("PARM", "Name", "Value")
    return {_text(row, "Name"): float(row["Value"]) for row in rows if isfinite(row["Value"])}


def _columns(raw: RawLog, topic: str, table: Table, names: Sequence[str]) -> Vector:
    lacking = [name for name in ("TimeUS", *names) if name not in table]
    if lacking:
        raise LogError([f"{raw.path}: {topic} has no {', '.join(lacking)}"])
    return np.column_stack([table[name].astype(np.float64) for name in names])


def _of(table: Table, chosen: NDArray[np.bool_]) -> Table:
    return {name: column[chosen] for name, column in table.items()}


def _add_estimate(raw: RawLog, records: _Records) -> None:
    """Add position, velocity and attitude of the estimator's core in use, and when its position was reset."""
    used = ESTIMATORS.get(int(raw.parameters.get("AHRS_EKF_TYPE", 3)), "XKF")
    topic = records.first(f"{used}1", *(f"{estimator}1" for estimator in ESTIMATORS.values()))
    if topic is None:
        raw.missing.append(ESTIMATE)
        return
    table, status = records.table(topic), records.table(f"{topic[:3]}4")
    if "C" in table:
        core = _primary_core(raw, status, table)
        table, status = _of(table, table["C"] == core), _of(status, status["C"] == core) if "C" in status else {}
    position = up_from_ned(_columns(raw, topic, table, ("PN", "PE", "PD")))
    stamps = stamps_us(table["TimeUS"])
    raw.samples["position"] = Samples(topic, stamps, position)
    velocity = up_from_ned(_columns(raw, topic, table, ("VN", "VE", "VD")))
    raw.samples["velocity"] = Samples(topic, stamps, velocity)
    _add_resets(raw, status)
    attitude, attitude_topic = records.table("ATT"), "ATT"
    if not attitude:
        attitude, attitude_topic = table, topic
    angles_deg = _columns(raw, attitude_topic, attitude, ("Roll", "Pitch", "Yaw"))
    # Yaw is logged from 0 to 360 degrees.
    angles_rad = np.remainder(angles_deg * (pi / 180.0) + pi, 2.0 * pi) - pi
    raw.samples["attitude"] = Samples(attitude_topic, stamps_us(attitude["TimeUS"]), up_from_ned(angles_rad))


def _add_resets(raw: RawLog, status: Table) -> None:
    """Add the times between which the last reset of the position, or the core in use, changed."""
    states = [np.nan_to_num(status[name].astype(np.float64)) for name in ("OFN", "OFE", "PI") if name in status]
    if not states or "TimeUS" not in status:
        return
    stamps = stamps_us(status["TimeUS"])
    changed = (np.diff(np.column_stack(states), axis=0) != 0.0).any(axis=1)
    raw.resets_us += [*stamps[:-1][changed].tolist(), *stamps[1:][changed].tolist()]


def _primary_core(raw: RawLog, status: Table, table: Table) -> int:
    """Return the estimator's core in use; if it changed, the one in use for longest, with a note."""
    selected = status.get("PI", np.empty(0, dtype=np.int8))
    present = np.unique(table["C"])
    cores, counts = np.unique(selected[np.isin(selected, present)], return_counts=True)
    if cores.size > 1:
        raw.notes.append(f"the estimator's core changed in flight, among {', '.join(map(str, cores.tolist()))}")
    if cores.size:
        return int(cores[counts.argmax()])
    wanted = raw.parameters.get("EK3_PRIMARY", 0)
    return int(wanted) if wanted in present else int(present[0])


def _add_setpoints(raw: RawLog, records: _Records) -> None:
    topic = records.first(SETPOINT, OLD_SETPOINT)
    if topic is None:
        raw.missing.append(SETPOINT)
        return
    table = records.table(topic)
    factor = _metres(raw, records, topic)
    logged = _columns(raw, topic, table, ("pX", "pY", "pZ"))
    rates = _columns(raw, topic, table, ("vX", "vY", "vZ")) * factor * (1.0, -1.0, 1.0)
    values = logged * factor
    submodes = table.get("Type", np.full(logged.shape[0], LOCATED[0]))
    values[~np.isin(submodes, POSITIONED)] = np.nan
    if topic == OLD_SETPOINT:
        values[(submodes == LOCATED[1]) & ~logged.any(axis=1)] = np.nan
    if "Type" in table:
        rates[submodes != FED] = np.nan
    # No vehicle flies as far in metres.
    located = np.isin(submodes, LOCATED) & (np.abs(values[:, :2]) > REACH_MAX_M).any(axis=1)
    located &= (np.abs(logged[:, :2]) <= PLACES_MAX).all(axis=1)
    if located.any():
        values[located] = np.nan
        raw.notes.append(f"{topic}: {int(located.sum())} targets in latitude and longitude were left out")
    if table.get("Terrain", np.zeros(1)).any():
        values[table["Terrain"] != 0, 2] = np.nan
        raw.notes.append(f"{topic}: heights above the terrain were left out")
    stamps = stamps_us(table["TimeUS"])
    # North, east, up; newer firmware logs down under the same name.
    up = values * np.array((1.0, -1.0, 1.0))
    if _is_down(raw, stamps, up[:, 2]):
        up[:, 2] *= -1.0
        rates[:, 2] *= -1.0
    raw.add_setpoints(topic, stamps, up, rates)


def _metres(raw: RawLog, records: _Records, topic: str) -> float:
    """Return the factor from the unit of the log's setpoints to metres; centimetres if the log states none."""
    if topic == OLD_SETPOINT:
        return 0.01
    factor = dict(NAMED_FACTORS).get(records.unit(topic, "pX"))
    if factor is None:
        raw.notes.append(f"{topic}: the log does not state the unit; centimetres assumed")
        return 0.01
    return factor


def _is_down(raw: RawLog, stamps: NDArray[np.int64], heights_m: Vector) -> bool:
    """Return whether the setpoints' heights fit the vehicle's altitude better with the opposite sign."""
    flown = raw.samples.get("position")
    known = np.isfinite(heights_m)
    if flown is None or not flown.stamps_us.size or not known.any():
        return False
    altitude_m = np.interp(stamps[known], flown.stamps_us, flown.values[:, 2])
    as_up, as_down = (np.median(np.abs(sign * heights_m[known] - altitude_m)) for sign in (1.0, -1.0))
    return bool(as_down < as_up)


def _add_truth(raw: RawLog, records: _Records) -> None:
    """Add the simulator's true motion: from its local frame if logged, else from its position on Earth."""
    table = records.table("SIM")
    origin = _origin(raw, records)
    if table and origin is not None:
        places = _columns(raw, "SIM", table, ("Lat", "Lng", "Alt"))
        wrong = np.flatnonzero((np.abs(places[:, 0]) > 90.0) | (np.abs(places[:, 1]) > 180.0))
        if wrong.size:
            at_s, (latitude, longitude, _) = table["TimeUS"][wrong[0]] / US, places[wrong[0]]
            where = f"{raw.path}: SIM at {at_s:.3f} s since boot: {latitude:.6g}, {longitude:.6g} degrees"
            raise LogError([f"{where} are not a position on Earth: wrong units, or a damaged log"])
        position = up_from_ned(MissionFrame(origin).ned_from_geodetics(*places.T))
        raw.samples["true_position"] = Samples("SIM", stamps_us(table["TimeUS"]), position)
    if table := records.table("SIM2"):
        velocity = up_from_ned(_columns(raw, "SIM2", table, ("VN", "VE", "VD")))
        raw.samples["true_velocity"] = Samples("SIM2", stamps_us(table["TimeUS"]), velocity)


def _origin(raw: RawLog, records: _Records) -> Geodetic | None:
    """Return the estimator's origin."""
    places = [row for row in records.rows("ORGN", *STAMPED, "Type", "Lat", "Lng", "Alt") if row["Type"] == 0]
    try:
        return Geodetic(places[-1]["Lat"], places[-1]["Lng"], places[-1]["Alt"]) if places else None
    except ValueError as error:
        where = f"{raw.path}: ORGN at {places[-1]['TimeUS'] / US:.3f} s since boot: {error}"
        raise LogError([f"{where}: wrong units, or a damaged log"]) from None


def _add_battery(raw: RawLog, records: _Records) -> None:
    table = records.table("BAT")
    instance = next((name for name in ("Inst", "Instance", "I") if name in table), None)
    if table and instance is not None:
        table = _of(table, table[instance] == table[instance][0])
    if not table or not {"Volt", "Curr"} <= table.keys():
        return
    left = table.get("RemPct", np.full(table["Volt"].shape, np.nan)) / 100.0
    values = np.column_stack((table["Volt"], table["Curr"], left)).astype(np.float64)
    raw.samples["battery"] = Samples("BAT", stamps_us(table["TimeUS"]), values)


def _add_modes(raw: RawLog, records: _Records) -> None:
    raw.mode_topic = "MODE"
    for row in records.rows("MODE", *STAMPED):
        number = row.get("ModeNum", row.get("Mode"))
        raw.modes.append((int(row["TimeUS"]), AUTOPILOT.mode(int(number if number is not None else -1))))
    if not raw.modes:
        raw.missing.append("MODE")
    armed = [
        (int(row["TimeUS"]), EVENTS[row["Id"]]) for row in records.rows("EV", *STAMPED, "Id") if row["Id"] in EVENTS
    ]
    armed += [(int(row["TimeUS"]), row["ArmState"] != 0) for row in records.rows("ARM", *STAMPED, "ArmState")]
    if not any(state for _, state in armed) and raw.parameters.get("LOG_DISARMED", 1.0) == 0.0 and raw.modes:
        # Logging begins when the vehicle is armed; the event itself may come too early to be logged.
        armed.append((raw.modes[0][0], True))
    raw.armed += sorted(armed)
