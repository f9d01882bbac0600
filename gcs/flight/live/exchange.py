"""What a program and the flying process that it started exchange, pickled over a pipe.

The program sends a `LiveRequest` first, then `Asked` for each command and END for each request to end. The flying
process sends the rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.ports import VehicleRefusedError
from agents.team.messages import CommandedRing
from agents.team.verbs import Verb
from estimation.frames import Triple
from gcs.console.command_client import CommandResult
from gcs.console.verb_arguments import GivenCommand
from gcs.errors import InputError
from gcs.flight.recording import RecordingOptions
from gcs.flight.request import FlightRequest
from gcs.metrics.record import FlightEvent, FlightRecord

PROGRAM_VARIABLE = "CORDON_PROGRAM"
"""The environment variable with the number of the flying process's end of the pipe."""
END = "end"
"""The request to end, as Ctrl-C: the vehicles hold, then land; after a second one they land at once."""


@dataclass(frozen=True, slots=True)
class LiveRequest:
    """A flight, its log, and the process id of the program that operates it."""

    flight: FlightRequest
    recording: RecordingOptions
    program_id: int


@dataclass(frozen=True, slots=True)
class Asked:
    """A command to vehicles, and its number among those of the program."""

    number: int
    verb: Verb
    given: GivenCommand


@dataclass(frozen=True, slots=True)
class LiveVehicle:
    """A vehicle in flight, by its agent and its autopilot.

    `tactic` is "standby", "formation", "encircle", "transit", "hold", "return and land", "land" or another that
    docs/glossary.md explains, `mode` the autopilot's. Positions [m] and velocities [m/s] are in the mission frame, z
    up, None before any telemetry. `radius_m` and `angular_rate_rad_s` (positive counter-clockwise) are about the target
    as it estimates it, None without an estimate. `ring` names its ring in a mission of several. `alert` is the failsafe
    condition that it reacts to, empty if none. `battery` is the share left, None if unknown. `ended` is how its flight
    ended, empty before.
    """

    id: int
    tactic: str
    mode: str
    armed: bool
    position_m: Triple | None
    velocity_m_s: Triple | None
    radius_m: float | None
    angular_rate_rad_s: float | None
    ring: str
    alert: str
    battery: float | None
    ended: str


@dataclass(frozen=True, slots=True)
class Begun:
    """The vehicles take off; the flight is recorded in `log`, None if it is not."""

    log: Path | None


@dataclass(frozen=True, slots=True)
class News:
    """The state of the team, and its events since the last news.

    `clock_s` is the time of its clock, `time_s` that since the mission's start, None before. `rings` are the values of
    each ring that operators commanded last.
    """

    clock_s: float
    time_s: float | None
    vehicles: Mapping[int, LiveVehicle]
    events: Sequence[FlightEvent]
    rings: Sequence[CommandedRing]


@dataclass(frozen=True, slots=True)
class Answers:
    """The vehicles' answers to a command by its number; None of a vehicle that did not answer in time."""

    number: int
    answers: Mapping[int, CommandResult | None]


@dataclass(frozen=True, slots=True)
class Failed:
    """The flight was refused, or its process was lost in flight."""

    error: InputError | VehicleRefusedError


@dataclass(frozen=True, slots=True)
class Over:
    """The flight is over: its record, None if the mission never began."""

    record: FlightRecord | None


Message = Begun | News | Answers | Failed | Over
"""What the flying process sends."""
