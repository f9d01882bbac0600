"""The autopilots that cordon knows, by their names in profiles and missions.

Each has a file of its name in gcs/autopilots and in sitl/autopilot, and a bundled profile.
"""

from typing import Literal

AutopilotName = Literal["px4", "ardupilot"]
DEFAULT: AutopilotName = "px4"
