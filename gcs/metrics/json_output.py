"""The JSON that commands print with `--json`, and the version of its format."""

import json
import re
from collections.abc import Mapping

from agents.team.text import CONTROL

JSON_FORMAT = 1
"""The version of all outputs (docs/json.md). It rises when a key goes or changes its meaning, not with new keys."""
_CONTROL = re.compile(f"[{CONTROL}]")


def json_output(result: Mapping[str, object]) -> str:
    """Return a result as one line of JSON after the version of its format, bytes as hexadecimal digits.

    All control characters are escaped. Raises ValueError rather than write NaN.
    """
    text = json.dumps({"format": JSON_FORMAT, **result}, allow_nan=False, ensure_ascii=False, default=bytes.hex)
    return _CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
