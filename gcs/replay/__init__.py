"""Flying again what a log holds: the same decisions, their story, and filters with other parameters."""
