"""The operators' verbs: one row for each, which vehicles, keyboard, command line, page and keys read.

What a verb does besides its event is in `agents/command_handler.py`. This module imports nothing heavy: the help of
`cordon` reads it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from agents.tactics import Event, Tactic

CommandVerb = Literal["hold", "resume", "land", "rtl", "abort", "kill", "formation", "ring", "assign", "goto", "look"]
"""The verbs of `cordon command`."""
Verb = Literal["start", "rejoin", CommandVerb]
Confirmation = Literal["none", "at once", "pilots", "all", "take-off", "word"]
"""What confirms a command from the keyboard or the page.

"at once" is "none" in an emergency: it also acts among pasted keys, and instead of a command that waits for its
confirmation. "pilots": `y`, or a dialog, if it takes vehicles back from their pilots. "all": `y` if it is for all
vehicles; on the page its button is held down. "take-off": both always are. "word": the verb is typed.
"""


@dataclass(frozen=True, slots=True)
class VerbRow:
    """A verb: `label` names it for people, `does` begins the question before it is sent, `help` is a sentence about it.

    Without a `key` it is not on the keyboard; `button` is its place on the page, 0 for none. `event` is its effect on
    the tactic, None if it has another effect. `did` answers it, and `already` in tactics that its event does not
    change. `done` is a second answer, after `did`, once the effect is confirmed. A verb that `needs_mission` depends on
    the mission file's content, which must be the team's. One that `is_dangerous` has to be granted by name. What a verb
    `takes` is its argument. One that takes a shape or a ring `is_for_team`; "assign" takes the name of a ring, or
    `auto`, for single vehicles of a mission of several rings; "place" is for single vehicles, too; "view" takes a place
    or `target`, for one vehicle or all. One that `is_for_landed` commands a single vehicle whose flight has ended; the
    others command those that fly.
    """

    name: Verb
    label: str
    key: str = ""
    button: int = 0
    confirmation: Confirmation = "none"
    event: Event | None = None
    did: str = ""
    already: Mapping[Tactic, str] = field(default_factory=dict)
    done: str = ""
    does: str = ""
    help: str = ""
    needs_mission: bool = False
    is_dangerous: bool = False
    takes: Literal["", "shape", "ring", "assign", "place", "view"] = ""
    is_for_landed: bool = False

    @property
    def is_for_team(self) -> bool:
        """Whether it commands the whole team, never some of its vehicles."""
        return self.takes in ("shape", "ring")

    @property
    def acts_late(self) -> bool:
        """Whether it is carried out whatever its age: it stops or ends a flight without cutting motors.

        A vehicle whose motors were to be cut may be above people by now.
        """
        return not self.is_dangerous and (self.confirmation == "at once" or self.event is Event.LAND)


_ON_MISSION = dict.fromkeys(
    (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.EXCITE), "was on its mission already"
)
_RESUMED = {Tactic.STANDBY: "was waiting for the start already", **_ON_MISSION}
_RETURNS = {Tactic.RETURN_AND_LAND: "was returning to land already"}
_ABORTS = "hover at once, land after `safety.abort_hover_s` unless resumed, or at a second abort"
_RESHAPES = "change the shape of the formation"
_RESIZES = "change radius, rate (clockwise if negative), altitude and tilt"
AUTO = "auto"
"""Stands for no ring where a vehicle is assigned: it chooses by itself."""
_ASSIGNS = "send a vehicle to one of several rings, or let it choose (auto)"
_JOINS, _TAKES_OFF = "take off and rejoin the mission with", "take off again and join the others"
_GOES = "send a vehicle to a place, where it holds, or lands (land)"
TARGET = "target"
"""Stands for the target where a camera looks."""
_LOOKS = "point the cameras at a place, or at the target again (target)"
_CUT, _FALL = "cut the motors of", "cut the motors; the vehicles fall"
_ROWS = (
    VerbRow("start", "start", did="takes off", needs_mission=True),
    VerbRow("hold", "hold", "h", 1, "at once", Event.HOLD, "holds", {Tactic.HOLD: "was holding already"}),
    VerbRow("resume", "resume", "r", 2, "pilots", Event.RESUME, "resumes its mission", _RESUMED, needs_mission=True),
    VerbRow("land", "land", "l", 4, "all", Event.LAND, "lands", {Tactic.LAND: "was landing already"}, does="land"),
    VerbRow("rtl", "return", "t", 3, "all", Event.RETURN, "returns and lands", _RETURNS, does="return and land"),
    VerbRow("abort", "abort", "a", 5, "at once", help=_ABORTS),
    VerbRow(
        "kill", "kill", "k", 9, "word", Event.LAND, "cuts the motors", {}, "motors cut", _CUT, _FALL, is_dangerous=True
    ),
    VerbRow(
        "rejoin",
        "rejoin",
        "j",
        8,
        "take-off",
        did="is checked",
        done="takes off and joins the others",
        does=_JOINS,
        help=_TAKES_OFF,
        needs_mission=True,
        is_for_landed=True,
    ),
    VerbRow("formation", "change formation", help=_RESHAPES, needs_mission=True, takes="shape"),
    VerbRow("ring", "change ring", button=6, help=_RESIZES, needs_mission=True, takes="ring"),
    VerbRow("assign", "assign ring", button=7, help=_ASSIGNS, needs_mission=True, takes="assign"),
    VerbRow("goto", "go to a place", help=_GOES, needs_mission=True, takes="place"),
    VerbRow("look", "look at a place", help=_LOOKS, needs_mission=True, takes="view"),
)
VERBS: Mapping[Verb, VerbRow] = {row.name: row for row in _ROWS}
"""The verbs by their names, in the order of lists."""
