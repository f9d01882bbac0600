"""Preflight, the plant file: whether what it was identified from is still this vehicle, as far as the file says."""

import re
from collections.abc import Iterator
from datetime import date

from estimation.plant.provenance import Identification, PlantGrade
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import Finding, Grade, VehicleFacts

OLD_DAYS = 180
_NUMBERS = re.compile(r"(\d+)\.(\d+)")
_WHY = "the controller is only as good as its plant: on the ring the vehicle would be off in radius and in rate"
_STEP = "identify it anew (cordon excite, cordon identify), and name the new file as its plant"


def plant_file(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle, today: date | None) -> Iterator[Finding]:
    """Check a plant file that says where it is from; the flight for its identification does not rest on it."""
    identified = vehicle.identified
    if identified is None or mission.excites:
        return
    doubts = [*_doubts(identified, facts, today), *_other_kind(identified, vehicle)]
    what = f"its plant file '{vehicle.section.plant}', identified on {identified.date}"
    found = f"{what}: {'; '.join(doubts)}" if doubts else f"{what} on its firmware, is {identified.verdict.value}"
    yield Finding.graded(Grade.WARNING if doubts else Grade.PASS, facts.subject, "plant", found, _WHY, _STEP)


def _doubts(identified: Identification, facts: VehicleFacts, today: date | None) -> Iterator[str]:
    if identified.verdict is PlantGrade.DO_NOT_FLY:
        reasons = "".join(f", {reason}" for reason in identified.reasons)
        yield f"its own verdict is '{identified.verdict.value}'{reasons}"
    days = 0 if today is None else (today - date.fromisoformat(identified.date)).days
    if days > OLD_DAYS:
        yield f"it is {days} days old"
    if identified.autopilot.lower() != facts.autopilot.value.lower():
        yield f"it is of {identified.autopilot}, and the vehicle flies {facts.autopilot.value}"
    elif _release(identified.firmware) != _release(facts.firmware) and identified.firmware and facts.firmware:
        yield f"it is of firmware {identified.firmware}, and the vehicle's is {facts.firmware}"


def _other_kind(identified: Identification, vehicle: MissionVehicle) -> Iterator[str]:
    gain = vehicle.plant.feedforward
    if identified.feeds and not gain:
        yield "it is of setpoints with velocities beside them, and with its feedforward = 0 none are sent"
    if gain and not identified.feeds:
        yield f"it is of setpoints alone, and with its feedforward = {gain:g} velocities are sent beside them"


def _release(firmware: str) -> tuple[str, ...] | str:
    """Return what may change how a vehicle flies: the first two numbers of a version, or all of what is none."""
    numbers = _NUMBERS.search(firmware)
    return firmware if numbers is None else numbers.groups()
