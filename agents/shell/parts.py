"""The parts of an agent."""

from collections.abc import Callable
from dataclasses import dataclass

from agents.core import VehicleCore
from agents.outputs import CoreStatus
from agents.ports import Heartbeat, PeerBus, TargetSensor, VehicleLink
from agents.settings.config import AgentConfig
from agents.shell.clock import MissionClock
from agents.team.external_positions import ExternalPositions
from agents.team.messages import MissionIdentity
from agents.team.perception import Perception


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentParts:
    """The parts of one agent.

    `core` was made from `config`. `make_sensor(start_s)` makes the sensor of the target once the start is known.
    `positions` reads externally measured positions, None if the autopilot needs none. `mission` is compared with that
    of peers and operators. `observe` is called on each tick with the core's status and its computing time [us], None
    outside the control loop.
    """

    core: VehicleCore
    config: AgentConfig
    link: VehicleLink
    bus: PeerBus
    clock: MissionClock
    make_sensor: Callable[[float], TargetSensor]
    observe: Callable[[CoreStatus, float | None], None]
    heartbeat: Heartbeat
    perception: Perception
    positions: ExternalPositions | None = None
    mission: MissionIdentity | None = None
