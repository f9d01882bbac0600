"""What sensors outside the team send on its bus."""

from agents.team import external_positions, perception

SENSOR_TOPICS = frozenset({perception.TOPIC, external_positions.TOPIC})
"""Sightings of the target, and positions of vehicles."""
