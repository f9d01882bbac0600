"""The verbs with which missions are chosen and written."""
