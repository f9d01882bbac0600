"""The option that describes an emulated radio: `baud=57600,latency_ms=60,loss=0.02`."""

import tomllib

from gcs.errors import InputError
from gcs.mission.validation import shown, validated
from sitl.radio.spec import RadioSpec


def radio_spec(text: str, option: str = "--radio") -> RadioSpec:
    """Parse the option; raises InputError with every fault."""
    content: dict[str, object] = {}
    faults: list[str] = []
    for part in text.split(","):
        key, equals, value = (each.strip() for each in part.partition("="))
        if not key.isidentifier() or (equals and not value):
            faults.append(f"{option}: {shown(part)} is not like latency_ms=60")
        elif key in content:
            faults.append(f"{option}.{key}: it is given twice")
        else:
            content[key] = _value(value) if equals else True
    spec = validated(RadioSpec, content, option, faults)
    if spec is None or faults:
        raise InputError(faults)
    return spec


def _value(text: str) -> object:
    """Return a number or a boolean; any other text unchanged, which no key accepts."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
