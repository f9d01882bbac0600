"""The interface for Python programs and notebooks: missions, simulated flights, flight logs and identification.

It may import gcs and the packages below it. A public name is imported when it is first used.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING

from cordon.package_names import shadowed, shared

if TYPE_CHECKING:
    from agents.control.plan import Plan as Plan
    from agents.control.plan import TaskPlanner as TaskPlanner
    from agents.ports import VehicleRefusedError as VehicleRefusedError
    from agents.settings.config import AgentConfig as AgentConfig
    from agents.situation.situation import Situation as Situation
    from agents.situation.task import Task as Task
    from agents.tactics import Tactic as Tactic
    from agents.team.messages import MemberState as MemberState
    from agents.team.messages import NeighbourAngle as NeighbourAngle
    from cordon.channels import VehicleChannels as VehicleChannels
    from cordon.flight import Flight as Flight
    from cordon.identification import Identified as Identified
    from cordon.identification import identify as identify
    from cordon.live_flight import LiveFlight as LiveFlight
    from cordon.live_flight import fly as fly
    from cordon.lockstep import LockstepClient as LockstepClient
    from cordon.reading import read as read
    from cordon.simulation import ReactingTarget as ReactingTarget
    from cordon.simulation import TargetPath as TargetPath
    from cordon.simulation import load as load
    from cordon.simulation import simulate as simulate
    from cordon.stub_team import StubTeam as StubTeam
    from cordon.stub_team import stubs as stubs
    from cordon.stub_vehicle import StubVehicle as StubVehicle
    from cordon.sweep_result import SweepResult as SweepResult
    from cordon.sweeping import sweep as sweep
    from estimation.plant.model import Plant as Plant
    from estimation.plant.model import PlantAxis as PlantAxis
    from estimation.polar import Polar as Polar
    from estimation.state import OwnEstimate as OwnEstimate
    from estimation.state import TargetEstimate as TargetEstimate
    from gcs.console.command_client import CommandResult as CommandResult
    from gcs.errors import InputError as InputError
    from gcs.flight.live.exchange import LiveVehicle as LiveVehicle
    from gcs.flight.simulated_events import Absent as Absent
    from gcs.flight.simulated_events import Commanded as Commanded
    from gcs.flight.simulated_events import Disturbance as Disturbance
    from gcs.flight.simulated_events import Link as Link
    from gcs.flight.simulated_events import MessageLoss as MessageLoss
    from gcs.metrics.record import FlightEvent as FlightEvent
    from gcs.metrics.result import FlightResult as FlightResult
    from gcs.mission.mission import Mission as Mission
    from gcs.sweep.draws import Draw as Draw
    from gcs.sweep.draws import Range as Range
    from sitl.server.true_state import TrueState as TrueState
    from sitl.vehicle.plant_step import StepFunction as StepFunction

_HOMES = {
    "Absent": "gcs.flight.simulated_events",
    "AgentConfig": "agents.settings.config",
    "Commanded": "gcs.flight.simulated_events",
    "CommandResult": "gcs.console.command_client",
    "Disturbance": "gcs.flight.simulated_events",
    "Draw": "gcs.sweep.draws",
    "Flight": "cordon.flight",
    "FlightEvent": "gcs.metrics.record",
    "FlightResult": "gcs.metrics.result",
    "Identified": "cordon.identification",
    "InputError": "gcs.errors",
    "Link": "gcs.flight.simulated_events",
    "LiveFlight": "cordon.live_flight",
    "LiveVehicle": "gcs.flight.live.exchange",
    "LockstepClient": "cordon.lockstep",
    "MemberState": "agents.team.messages",
    "MessageLoss": "gcs.flight.simulated_events",
    "Mission": "gcs.mission.mission",
    "NeighbourAngle": "agents.team.messages",
    "OwnEstimate": "estimation.state",
    "Plan": "agents.control.plan",
    "Plant": "estimation.plant.model",
    "PlantAxis": "estimation.plant.model",
    "Polar": "estimation.polar",
    "Range": "gcs.sweep.draws",
    "ReactingTarget": "cordon.simulation",
    "Situation": "agents.situation.situation",
    "StepFunction": "sitl.vehicle.plant_step",
    "StubTeam": "cordon.stub_team",
    "StubVehicle": "cordon.stub_vehicle",
    "SweepResult": "cordon.sweep_result",
    "Tactic": "agents.tactics",
    "TargetEstimate": "estimation.state",
    "TargetPath": "cordon.simulation",
    "Task": "agents.situation.task",
    "TaskPlanner": "agents.control.plan",
    "TrueState": "sitl.server.true_state",
    "VehicleChannels": "cordon.channels",
    "VehicleRefusedError": "agents.ports",
    "fly": "cordon.live_flight",
    "identify": "cordon.identification",
    "load": "cordon.simulation",
    "read": "cordon.reading",
    "simulate": "cordon.simulation",
    "stubs": "cordon.stub_team",
    "sweep": "cordon.sweeping",
}
"""Where each public name is defined."""

for _words in shadowed() or shared():
    warnings.warn(_words, stacklevel=2)


if not TYPE_CHECKING:  # a type checker uses the imports above, and reports names that do not exist

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used."""
        if name not in _HOMES:
            raise AttributeError(f"module 'cordon' has no attribute {name!r}")
        from cordon.docstrings import documented  # noqa: PLC0415

        value = globals()[name] = documented(getattr(import_module(_HOMES[name]), name))
        return value

    def __dir__() -> list[str]:
        return sorted(_HOMES)
