"""Flight logs: what is recorded, writing and reading it, and reading the logs of autopilots."""
