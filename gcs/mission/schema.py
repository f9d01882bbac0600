"""The JSON Schema of a mission file, generated from the models that validate it, for editors."""

from typing import Any

from pydantic import Field, create_model

from estimation.settings import Settings
from gcs.mission.links import SharedLinkSection
from gcs.mission.mission import VehicleSection
from gcs.mission.sections import REQUIRED, SECTIONS, TUNING, VEHICLES_MAX


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
    )
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **mission.model_json_schema()}
