"""The verbs that list, describe and write missions."""
