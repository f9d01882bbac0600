"""Experiments: programs that measure, each run by `python -m tests.experiments.NAME`; pytest does not collect them."""
