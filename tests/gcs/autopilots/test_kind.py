"""What a vehicle is, by what it says: measured identities of PX4's simulator, and what stubs and boards say."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs.autopilots.ardupilot import AUTOPILOT as ARDUPILOT
from gcs.autopilots.autopilot import Evidence, VehicleKind
from gcs.autopilots.px4 import AUTOPILOT as PX4
from gcs.link.relay.frames import is_hil

SITL_UID = 5283920058631409231
"""PX4 1.17's simulator reported this as system 1."""
STUB_UID = int.from_bytes(b"STUB\0\0\0\1")
PLAIN, SIMULATED = {"FS_GCS_ENABLE": 5.0, "SIM_OPOS_LAT": None}, {"FS_GCS_ENABLE": 5.0, "SIM_OPOS_LAT": 47.0}
BOARD_UID = 0x0000_0030_3130_3738


def px4(uid: int | None, sys_hitl: float | None = 0.0, *, hil: bool = False, system_id: int = 1) -> VehicleKind:
    return PX4.kind(Evidence(system_id, uid, 0x26AC, hil=hil, parameters={"SYS_HITL": sys_hitl}))


@pytest.mark.parametrize(
    ("found", "kind"),
    [
        (px4(BOARD_UID), VehicleKind.FLIGHT),
        (px4(BOARD_UID, 2.0, hil=True), VehicleKind.BOARD),
        (px4(BOARD_UID, 1.0, hil=True), VehicleKind.BOARD_OUTER),
        (px4(SITL_UID), VehicleKind.SIMULATOR),
        (px4(SITL_UID + 2, system_id=3), VehicleKind.SIMULATOR),
        (px4(SITL_UID, system_id=3), VehicleKind.FLIGHT),
        (px4(STUB_UID), VehicleKind.STUB),
        (px4(BOARD_UID, 2.0), VehicleKind.UNKNOWN),
        (px4(BOARD_UID, 0.0, hil=True), VehicleKind.UNKNOWN),
        (px4(None, None, hil=True), VehicleKind.UNKNOWN),
    ],
)
def test_a_px4_vehicle_is_what_its_messages_agree_on(found: VehicleKind, kind: VehicleKind) -> None:
    assert found is kind


@pytest.mark.parametrize(
    ("evidence", "kind"),
    [
        (Evidence(1, 5, 0x1209, parameters=PLAIN), VehicleKind.FLIGHT),
        (Evidence(1, 5, 0x1209, parameters=SIMULATED), VehicleKind.BOARD),
        (Evidence(1, 5, 0, parameters=SIMULATED), VehicleKind.SIMULATOR),
        (Evidence(1, STUB_UID, 0, parameters=PLAIN), VehicleKind.STUB),
        (Evidence(1), VehicleKind.UNKNOWN),
    ],
)
def test_an_ardupilot_vehicle_simulates_where_it_has_a_simulators_parameters(
    evidence: Evidence, kind: VehicleKind
) -> None:
    assert ARDUPILOT.kind(evidence) is kind


def test_an_unknown_vehicle_counts_as_one_that_flies() -> None:
    assert [kind for kind in VehicleKind if not kind.is_simulated] == [VehicleKind.FLIGHT, VehicleKind.UNKNOWN]
    assert [kind for kind in VehicleKind if kind.is_board] == [VehicleKind.BOARD, VehicleKind.BOARD_OUTER]


@pytest.mark.parametrize(("base_mode", "hil"), [(145, False), (145 + 32, True)])
def test_the_flag_is_read_from_the_bytes_of_a_heartbeat(base_mode: int, hil: bool) -> None:
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    assert is_hil(bytes(sender.heartbeat_encode(2, 12, base_mode, 393216, 4).pack(sender))) is hil
