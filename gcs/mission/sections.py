"""The names of a mission file's sections and of the tables of `[tuning]`, with their models, and the JSON Schema."""

from typing import Any

from pydantic import Field, create_model

from agents.settings.sections import (
    ChoreographySettings,
    DecisionSettings,
    EncirclementSection,
    EncirclementSettings,
    ExcitationSettings,
    FailsafeSection,
    FailsafeSettings,
    FormationSection,
    FormationSettings,
    SafetySection,
    SafetySettings,
)
from agents.settings.tuning import EncirclementTuning, FailsafeTuning, FormationTuning, SafetyTuning
from agents.team.messages import RINGS_MAX, TARGETS_MAX
from estimation.settings import Settings, TargetBehaviour, TargetFilterSettings, TargetFilterTuning
from gcs.mission.mission import (
    CHECKLIST_MAX,
    ChecklistItem,
    FrameSection,
    LinkSection,
    MissionSection,
    NetworkSection,
    RingSection,
    SharedLinkSection,
    SimulationSection,
    TargetSection,
    VehicleSection,
    VerdictSection,
)

EXCITES = "excite"
"""The top-level key that makes a mission the excitation flight of the vehicle of that id."""
ADDED = "added"
"""The top-level key with the id of the last vehicle, which is not in the mission file and joins its flight."""
SECTIONS: dict[str, type[Settings]] = {
    "mission": MissionSection,
    "frame": FrameSection,
    "formation": FormationSection,
    "encirclement": EncirclementSection,
    "decision": DecisionSettings,
    "safety": SafetySection,
    "failsafe": FailsafeSection,
    "target": TargetSection,
    "network": NetworkSection,
    "link": LinkSection,
    "choreography": ChoreographySettings,
    "excitation": ExcitationSettings,
    "simulation": SimulationSection,
    "verdicts": VerdictSection,
}
"""The sections of a mission file: what a user decides."""
TUNING: dict[str, type[Settings]] = {
    "formation": FormationTuning,
    "encirclement": EncirclementTuning,
    "safety": SafetyTuning,
    "failsafe": FailsafeTuning,
    "target_filter": TargetFilterTuning,
}
"""The tables of `[tuning]`, whose defaults suit every mission."""
TUNED: dict[str, tuple[str, type[Settings]]] = {
    "formation": ("formation", FormationSettings),
    "encirclement": ("encirclement", EncirclementSettings),
    "safety": ("safety", SafetySettings),
    "failsafe": ("failsafe", FailsafeSettings),
    "target_filter": ("target", TargetFilterSettings),
}
"""The settings merged from a section and a table of `[tuning]`, by the name of the table."""
VEHICLES_MAX = 254
"""The number of MAVLink system ids."""
REQUIRED = ("mission", "frame", "formation", "encirclement", "target")


def mission_schema() -> dict[str, Any]:
    """Return the schema of present mission files; only `cordon check` checks keys against each other."""
    tables: dict[str, Any] = {name: (model, Field(default_factory=model)) for name, model in TUNING.items()}
    tuning: Any = create_model("Tuning", __base__=Settings, __doc__="Tuning of the controllers.", **tables)
    sections: dict[str, Any] = {
        name: (model, ... if name in REQUIRED else Field(default_factory=model)) for name, model in SECTIONS.items()
    }
    mission = create_model(
        "Mission",
        __base__=Settings,
        __doc__="A mission of cordon.",
        **sections,
        tuning=(tuning, Field(default_factory=tuning)),
        links=(dict[str, SharedLinkSection], Field(default_factory=dict)),
        vehicles=(list[VehicleSection], Field(min_length=1, max_length=VEHICLES_MAX)),
        targets=(list[TargetSection], Field(default_factory=list, min_length=1, max_length=TARGETS_MAX)),
        rings=(list[RingSection], Field(default_factory=list, min_length=1, max_length=RINGS_MAX)),
        checklist=(list[ChecklistItem], Field(default_factory=list, max_length=CHECKLIST_MAX)),
    )
    schema = mission.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, **_with_tables(schema)}


def _with_tables(schema: dict[str, Any]) -> dict[str, Any]:
    """Return what replaces parts of a schema for `[[targets]]` and `[[rings]]`.

    They are completed from `[target]` and `[encirclement]`, which then need not be complete, nor there at all.
    """
    kinds = schema["$defs"]
    whole = {name: kinds[name].pop("required") for name in ("TargetSection", "SensorSection", "EncirclementSection")}
    target = kinds["TargetSection"]
    own = {key: value for key, value in target["properties"].items() if key not in TargetBehaviour.model_fields}
    kinds["TargetEntry"] = {**target, "title": "TargetEntry", "properties": own, "required": ["name"]}
    kinds["RingSection"]["required"] = ["places"]
    tables = schema["properties"]
    tables["targets"]["items"] = {"$ref": "#/$defs/TargetEntry"}
    complete = {
        "target": {
            "required": whole["TargetSection"],
            "properties": {"sensor": {"required": whole["SensorSection"]}},
        },
        "encirclement": {"required": whole["EncirclementSection"]},
    }
    return {
        "properties": tables,
        "required": [name for name in schema["required"] if name not in complete],
        "allOf": [
            {"if": {"required": [several]}, "else": {"required": [one], "properties": {one: complete[one]}}}
            for several, one in (("targets", "target"), ("rings", "encirclement"))
        ],
    }
