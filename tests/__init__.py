"""The tests, and the one command that checks everything: `python -m tests`."""
