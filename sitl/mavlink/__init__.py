"""The MAVLink dialects of the stub: messages, commands, missions and parameters.

It may import autopilot and mavlink_constants.
"""
