"""Preflight checks of the profile: that it is for this autopilot, and that its plant describes this vehicle."""

import re
from collections.abc import Iterator
from datetime import date

from estimation.plant.provenance import Identification, PlantGrade
from gcs.autopilots.registry import UNKNOWN, autopilot_of
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import Finding, Grade, VehicleFacts

OLD_DAYS = 180
_NUMBERS = re.compile(r"(\d+)\.(\d+)")
_WHY = "the controller relies on the plant: with a wrong one, radius and rate on the ring are off"
_STEP = "identify it again (cordon excite, cordon identify), and set its profile to the new file"


def profile(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle, today: date | None) -> Iterator[Finding]:
    """Check a vehicle's profile against the vehicle's reports.

    An excitation flight does not depend on the profile, and is not checked. Without `today` no profile is old.
    """
    if mission.excites:
        return
    other = list(_other_autopilot(facts, vehicle))
    yield from other
    identified = vehicle.profile.identified
    if identified is None:
        return
    reservations = [*_reservations(identified, facts, today), *_other_kind(identified, vehicle)]
    if not other and identified.autopilot.lower() != facts.autopilot.label.lower():
        reservations.append(
            f"it was identified with {identified.autopilot}, and the vehicle flies {facts.autopilot.label}"
        )
    what = f"its profile '{vehicle.section.profile}', identified on {identified.date}"
    found = (
        f"{what}: {'; '.join(reservations)}"
        if reservations
        else f"{what} with its firmware, is {identified.verdict.value}"
    )
    yield Finding.graded(Grade.WARNING if reservations else Grade.PASS, facts.vehicle_id, "profile", found, _WHY, _STEP)


def _other_autopilot(facts: VehicleFacts, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Refuse a profile of another autopilot; a warning if the mission itself states this autopilot."""
    key = vehicle.profile.autopilot
    if key is None or facts.autopilot in (autopilot_of(key), UNKNOWN):
        return
    chosen = vehicle.section.autopilot
    meant = chosen is not None and autopilot_of(chosen) is facts.autopilot
    yield Finding(
        Grade.WARNING if meant else Grade.REFUSE,
        facts.vehicle_id,
        "profile",
        f"its profile '{vehicle.section.profile}' is for {autopilot_of(key).label} (autopilot = \"{key}\"), and the "
        f"vehicle reports {facts.autopilot.label}",
        "plant, filter and limits of another autopilot do not describe this vehicle",
        f"use a profile for {facts.autopilot.label} in the mission, or check the url",
    )


def _reservations(identified: Identification, facts: VehicleFacts, today: date | None) -> Iterator[str]:
    if identified.verdict is PlantGrade.DO_NOT_FLY:
        reasons = "".join(f", {reason}" for reason in identified.reasons)
        yield f"its own verdict is '{identified.verdict.value}'{reasons}"
    days = 0 if today is None else (today - date.fromisoformat(identified.date)).days
    if days > OLD_DAYS:
        yield f"it is {days} days old"
    same = identified.autopilot.lower() == facts.autopilot.label.lower()
    if same and _release(identified.firmware) != _release(facts.firmware) and identified.firmware and facts.firmware:
        yield f"it was identified with firmware {identified.firmware}, and the vehicle's is {facts.firmware}"


def _other_kind(identified: Identification, vehicle: MissionVehicle) -> Iterator[str]:
    gain = vehicle.plant.feedforward
    if identified.feeds and not gain:
        yield "it was identified with velocities beside setpoints, and with feedforward = 0 none are sent"
    if gain and not identified.feeds:
        yield f"it was identified with setpoints alone, and with feedforward = {gain:g} velocities are sent as well"


def _release(firmware: str) -> tuple[str, ...] | str:
    """Return the part of a firmware that may affect the plant: the first two numbers, or all of any other text."""
    numbers = _NUMBERS.search(firmware)
    return firmware if numbers is None else numbers.groups()
