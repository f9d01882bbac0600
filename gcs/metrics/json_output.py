"""The JSON that commands print with `--json`, and the version of its format."""

import json
from collections.abc import Mapping

JSON_FORMAT = 1
"""The version of all outputs (docs/json.md). It rises when a key goes or changes its meaning, not with new keys."""


def json_output(result: Mapping[str, object]) -> str:
    """Return a result as one line of JSON after the version of its format, bytes as hexadecimal digits.

    Raises ValueError rather than write NaN.
    """
    return json.dumps({"format": JSON_FORMAT, **result}, allow_nan=False, ensure_ascii=False, default=bytes.hex)
