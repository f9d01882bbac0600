"""What several commands of the command line take, each said once."""

from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter
from cyclopts.validators import Number

RESULT = Group("Result")

MissionName = Annotated[
    str,
    Parameter(
        help="A bundled mission (case1, case2, case2-field, case3-turns, shaped-trio, px4-trio and others), or "
        "a TOML file."
    ),
]
RunningMission = Annotated[str, Parameter(help="The mission that is being flown: it says where the team is.")]
Seed = Annotated[
    int | None,
    Parameter(help="Seed of noise, delay and loss, in place of the mission's.", validator=Number(gte=0)),
]
Duration = Annotated[
    float | None,
    Parameter(help="Seconds of mission time to fly, in place of the mission's.", validator=Number(gt=0, lte=86400)),
]
Speed = Annotated[
    float | None,
    Parameter(help="How many times faster than the wall simulated time passes.", validator=Number(gte=0.1, lte=50)),
]
Json = Annotated[bool, Parameter(name="--json", negative="", group=RESULT, help="Print the result as one JSON object.")]
Plot = Annotated[
    Path | None,
    Parameter(group=RESULT, help="Draw the flight, the paper's figures 1 to 6, into a .png, .svg or .pdf."),
]
Log = Annotated[
    Path | None,
    Parameter(group=RESULT, help="Record the flight in this file (MCAP), which must not exist yet."),
]
LogFile = Annotated[Path, Parameter(help="A log that cordon recorded (MCAP).")]
Timing = Annotated[
    bool | None,
    Parameter(
        group=RESULT,
        help="Whether the JSON holds wall times. It does unless a seed is given: one seed, one result, byte for byte.",
    ),
]
