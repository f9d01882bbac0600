"""The command line of the experiments."""

from argparse import ArgumentParser


def parser(name: str, description: str) -> ArgumentParser:
    """Return the parser of `tests.experiments.NAME`; the first line of `description` is its description."""
    return ArgumentParser(prog=f"python -m tests.experiments.{name}", description=description.splitlines()[0])


def seeded_parser(name: str, description: str, count: int) -> ArgumentParser:
    """Return a parser with the arguments `count` (of seeds, with a default) and `first` (the first seed, 0)."""
    reader = parser(name, description)
    reader.add_argument("count", nargs="?", type=int, default=count, help="number of seeds (default: %(default)s)")
    reader.add_argument("first", nargs="?", type=int, default=0, help="first seed (default: %(default)s)")
    return reader
