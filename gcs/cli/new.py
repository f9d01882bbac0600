"""`cordon new`: a new mission file, flown once in simulation."""

import re
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import ceil, isfinite
from pathlib import Path
from typing import Annotated, TypeVar, get_args

from cyclopts import Parameter

from agents.settings.shapes import SPACED_SHAPES, SpacedShape
from estimation.input_file import TEXT_MAX_LENGTH, read_plain
from estimation.profile.autopilots import AutopilotName
from gcs.cli.options import Plot, only_file
from gcs.errors import Exit, InputError
from gcs.mission.template import (
    PROFILES,
    REAL_LINKS,
    SEPARATION_M,
    SIMULATED_PLACE,
    X_BEARING_DEG,
    Links,
    MissionPlace,
    NewMission,
    least_radius_m,
    own_ports,
    plant_profile,
    ring_words,
)

T = TypeVar("T")


class Questions:
    """Asks for missing options on a terminal (`asks`); without a terminal it collects their names."""

    def __init__(self) -> None:
        from gcs.console.terminal import STDERR

        self.asks = sys.stdin.isatty() and STDERR.is_terminal
        self._missing: list[str] = []

    def answer(self, given: object, option: str, question: str, proposal: str, parse: Callable[[str], T]) -> T:
        """Return the value of the option, or the answer if it is None; Enter accepts the proposal.

        Without a terminal it returns the proposal; `require_all` then fails. Raises InputError, also at end of input.
        """
        if given is not None:
            return parsed(option, f"{given}", parse)
        if not self.asks:
            self.miss(option, question)
            return parse(proposal)
        return self._asked(option, question, proposal, parse)

    def miss(self, option: str, question: str) -> None:
        """Note that an option is missing."""
        self._missing.append(f"{option}: missing, and there is no terminal to ask on ({question})")

    @property
    def is_missing(self) -> bool:
        """Whether an option is missing so far."""
        return bool(self._missing)

    def require_all(self) -> None:
        """Raise InputError with all options that are missing."""
        if self._missing:
            raise InputError(self._missing)

    @staticmethod
    def _asked(option: str, question: str, proposal: str, parse: Callable[[str], T]) -> T:
        from rich.prompt import Prompt
        from rich.text import Text

        from gcs.console.terminal import STDERR, print_line

        while True:
            try:
                return parse(
                    Prompt.ask(Text(question), console=STDERR, default=proposal, show_default=bool(proposal)).strip()
                )
            except EOFError as error:
                raise InputError([f"{option}: the input ended; nothing was written"]) from error
            except ValueError as error:
                print_line(f"{option}: {error}", "yellow")


def parsed(option: str, text: str, parse: Callable[[str], T]) -> T:
    """Return the value of an option; raises InputError."""
    try:
        return parse(text)
    except ValueError as error:
        raise InputError([f"{option}: {error}"]) from error


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers from `low` to `high`; it raises ValueError."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise ValueError(f"a whole number between {low} and {high} (given: {text!r})")
        return int(text)

    return read


def number(low: float, high: float, reason: str = "") -> Callable[[str], float]:
    """Return a parser of numbers from `low` to `high`; its ValueError states the reason for the limits."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value) or not low <= value <= high:
            raise ValueError(f"a number between {low:g} and {high:g}{reason}, without unit (given: {text!r})")
        return value

    return read


def one_of(choices: tuple[T, ...]) -> Callable[[str], T]:
    """Return a parser of one of several words; it raises ValueError."""

    def read(text: str) -> T:
        for choice in choices:
            if choice == text:
                return choice
        raise ValueError(f"one of {', '.join(map(str, choices))} (given: {text!r})")

    return read


LINKS: tuple[Links, ...] = get_args(Links)
AUTOPILOTS = get_args(AutopilotName)
TARGETS = {"rest": 0.0, "moving": 0.1}
"""Words for the speed of the target [m/s]."""
TARGET_MAX_M_S = 5.0
_PORT = re.compile(r":(\d{4,5})\b")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class NewOptions:
    """Options of `cordon new`, without the file; it asks for missing ones."""

    vehicles: Annotated[int | None, Parameter(help="How many vehicles.")] = None
    links: Annotated[
        Links | None,
        Parameter(
            help=f"How vehicles are connected: stub (bundled, no hardware), {' or '.join(AUTOPILOTS)} (their "
            "simulators), udp or serial (real vehicles)."
        ),
    ] = None
    profile: Annotated[
        str | None,
        Parameter(
            help=f"The vehicles' profile: a bundled one (stub, {', '.join(AUTOPILOTS)} and others), a file in the "
            "folder of the mission, or a plant x'' = a0 (X_d - x) - a1 x' with a delay in seconds as A0,A1,DELAY, such "
            "as 0.8,0.9,0.1. The default follows --links."
        ),
    ] = None
    shape: Annotated[SpacedShape | None, Parameter(help="Shape of the formation.")] = None
    radius: Annotated[float | None, Parameter(help="Radius of the ring in metres.")] = None
    rate: Annotated[
        float | None, Parameter(help="Angular rate on the ring in rad/s; the speed is radius times rate.")
    ] = None
    target: Annotated[
        str | None, Parameter(help="The target: rest, moving (at 0.1 m/s along x), or its speed in m/s.")
    ] = None
    target_start: Annotated[str | None, Parameter(help="Target's start: X,Y in m.")] = None
    place: Annotated[
        str | None, Parameter(help="Where real vehicles stand: LATITUDE,LONGITUDE,ALTITUDE[,BEARING of x].")
    ] = None
    fence: Annotated[
        float | None,
        Parameter(help="Margin in metres between the flight and a geofence around it; 0 for no fence."),
    ] = None
    plot: Plot = None


_DEFAULTS = NewOptions()


def new(
    file: Annotated[
        Path | None,
        Parameter(validator=only_file, help="The mission file to write, such as my.toml; it must not exist yet."),
    ] = None,
    /,
    *,
    options: NewOptions = _DEFAULTS,
) -> Exit:
    """Write a new mission file with a comment for each key, and fly it once in simulation.

    Asks for missing options. The mission has its own team name and ports, so that it can fly beside other missions.

    Example: cordon new my.toml --vehicles 5 --links stub --shape wedge --radius 15 --rate 0.1 --target rest --fence 9
    """
    from gcs.cli.output import check_file, check_plot
    from gcs.cli.sim import SimOptions, sim
    from gcs.console.terminal import print_line, print_problem
    from gcs.mission.file import parse_mission

    check_plot(options.plot)
    ask = Questions()
    try:
        path = ask.answer(file, "FILE", "File to write?", "my.toml", Path)
        if not ask.is_missing:
            check_file("FILE", path, (".toml",))
            _require_new(path)
        own_profile = path.with_name(f"{path.stem}-profile.toml")
        profile, mission = _chosen(ask, options, path, own_profile.name)
    except KeyboardInterrupt:
        print_problem("interrupted: nothing was written")
        return Exit.REFUSED
    profiles = {own_profile.name: profile} if profile else {}
    if profile:
        _require_new(own_profile)
    parse_mission(mission.text, path.parent, profiles)
    for name, text in {**profiles, path.name: mission.text}.items():
        _write(path.with_name(name), text)
        print_line(f"written: {path.with_name(name)}")
    verdict = sim(SimOptions(mission=str(path), plot=options.plot))
    # Stubs speak over UDP and TCP: a serial line has a vehicle at its other end.
    print_line(
        f"next: cordon check {path}" if mission.links == "serial" else f"next: cordon fly {path} --sitl --speed 10"
    )
    return verdict


def _require_new(path: Path) -> None:
    if path.exists():
        raise InputError([f"FILE: {path} exists already and is not overwritten; choose another name"])


def _write(path: Path, text: str) -> None:
    from gcs.cli.output import writing
    from gcs.keys.private_files import create

    with writing("FILE", path), create(path, "xb") as file:
        file.write(text.encode())


def _chosen(ask: Questions, options: NewOptions, path: Path, own_profile: str) -> tuple[str, NewMission]:
    """Return the text of a profile with a given plant, empty without one, and the mission, from options and answers.

    Raises InputError.
    """
    from gcs.console.terminal import print_line

    vehicles = ask.answer(options.vehicles, "--vehicles", "How many vehicles?", "3", whole(1, 254))
    links = ask.answer(options.links, "--links", f"Connection: {', '.join(LINKS)}?", "stub", one_of(LINKS))
    profile = options.profile or _profile(ask, options, links, path.parent)
    place, x_bearing_deg = _where(ask, options, links)
    plant = parsed("--profile", profile, _plant)
    shape = ask.answer(
        options.shape, "--shape", f"Formation: {', '.join(SPACED_SHAPES)}?", "line", one_of(SPACED_SHAPES)
    )
    least_m = least_radius_m(vehicles)
    wide, ring = f"{max(10, ceil(1.5 * least_m))}", number(least_m, 1000.0, f" for {SEPARATION_M:g} m between vehicles")
    radius_m = ask.answer(options.radius, "--radius", "Radius of the ring in m?", wide, ring)
    slow = f"{min(0.1, 1.0 / radius_m):.2g}"
    question = f"Angular rate on the ring in rad/s ({ring_words(radius_m, float(slow))})?"
    rate_rad_s = ask.answer(options.rate, "--rate", question, slow, number(-2.0, 2.0))
    if not ask.is_missing:
        print_line(f"ring: {ring_words(radius_m, rate_rad_s)}")
    question = "Target: rest, moving, or its speed along x in m/s?"
    target_m_s = ask.answer(options.target, "--target", question, "moving", _target_speed_m_s)
    target_start_m = _target_start(ask, options)
    fence_m = ask.answer(options.fence, "--fence", "Margin to a fence in m, 0 for no fence?", "20", number(0.0, 1000.0))
    ask.require_all()
    mission = NewMission(
        name=path.stem,
        vehicles=vehicles,
        links=links,
        profile=own_profile if plant else profile,
        shape=shape,
        radius_m=radius_m,
        angular_rate_rad_s=rate_rad_s,
        target_speed_m_s=target_m_s,
        fence_m=fence_m,
        ports=own_ports(path.stem, vehicles, _ports_beside(path)),
        place=place,
        x_bearing_deg=x_bearing_deg,
        target_start_m=target_start_m,
    )
    return plant, mission


def _where(ask: Questions, options: NewOptions, links: Links) -> tuple[MissionPlace, float]:
    """Return where the vehicles stand, and the direction of flight; real ones have no default."""
    if links in REAL_LINKS:
        question = "Place of the vehicles: LATITUDE,LONGITUDE,ALTITUDE of the ground?"
        if options.place is None and not ask.asks:
            ask.miss("--place", question)  # then nothing is written
            return SIMULATED_PLACE, X_BEARING_DEG
        return ask.answer(options.place, "--place", question, "", _place)
    if options.place is None:
        return SIMULATED_PLACE, X_BEARING_DEG
    return parsed("--place", options.place, _place)


def _place(text: str) -> tuple[MissionPlace, float]:
    """Return a place and a direction of flight; raises ValueError."""
    parts = text.split(",")
    if len(parts) not in (3, 4):
        raise ValueError(f"LATITUDE,LONGITUDE,ALTITUDE, such as 47.397742,8.545594,488 (given: {text!r})")
    latitude_deg, longitude_deg = number(-90.0, 90.0)(parts[0]), number(-180.0, 180.0)(parts[1])
    x_bearing_deg = number(0.0, 360.0)(parts[3]) if len(parts) > 3 else X_BEARING_DEG
    return MissionPlace(latitude_deg, longitude_deg, number(-500.0, 9000.0)(parts[2])), x_bearing_deg


AHEAD = "ahead"


def _target_start(ask: Questions, options: NewOptions) -> tuple[float, float] | None:
    """Return where the target is at first, None for straight ahead; asked for where there is a terminal."""
    if options.target_start is None and not ask.asks:
        return None
    question = f"Where is the target at first: {AHEAD}, or X,Y in m, x ahead and y to the left?"
    return ask.answer(options.target_start, "--target-start", question, AHEAD, _position_m)


def _position_m(text: str) -> tuple[float, float] | None:
    """Return a position, None for one that follows from the ring; raises ValueError."""
    if text == AHEAD:
        return None
    parts = text.split(",")
    if len(parts) != 2:
        raise ValueError(f"{AHEAD}, or X,Y in metres, such as 60,-20 (given: {text!r})")
    metres = number(-5000.0, 5000.0)
    return metres(parts[0]), metres(parts[1])


def _profile(ask: Questions, options: NewOptions, links: Links, folder: Path) -> str:
    """Return the profile that fits the links, or the answer if the other questions are asked as well."""
    required = (
        options.vehicles,
        options.links,
        options.shape,
        options.radius,
        options.rate,
        options.target,
        options.fence,
    )
    if not ask.asks or None not in required:
        return PROFILES[links]
    question = "Profile: a bundled one, a file, or a plant as A0,A1,DELAY?"
    return ask.answer(None, "--profile", question, PROFILES[links], partial(_known_profile, folder))


def _known_profile(folder: Path, text: str) -> str:
    """Return a valid profile name or plant; raises ValueError."""
    from estimation.profile.profile import ProfileError, ProfileLibrary

    if not _plant(text):
        try:
            ProfileLibrary(folder).load(text)
        except ProfileError as error:
            raise ValueError("; ".join(error.faults)) from error
    return text


def _plant(profile: str) -> str:
    """Return the text of a profile with a given plant, empty for the name of a profile; raises ValueError."""
    if "," not in profile:
        return ""
    numbers = profile.split(",")
    if len(numbers) != 3:
        raise ValueError(f"a plant is A0,A1,DELAY, such as 0.8,0.9,0.1 (given: {profile!r})")
    positive = number(0.01, 100.0)
    return plant_profile(positive(numbers[0]), positive(numbers[1]), number(0.0, 1.0)(numbers[2]))


def _target_speed_m_s(text: str) -> float:
    """Return the target's speed; raises ValueError."""
    return TARGETS[text] if text in TARGETS else number(0.0, TARGET_MAX_M_S)(text)


def _ports_beside(path: Path) -> set[int]:
    """Return the ports named in the other files of a new mission's folder."""
    found: set[int] = set()
    for other in path.parent.glob("*.toml"):
        with suppress(OSError):  # no file, or none that can be read
            found |= set(map(int, _PORT.findall(read_plain(other, 4 * TEXT_MAX_LENGTH).decode(errors="replace"))))
    return found
