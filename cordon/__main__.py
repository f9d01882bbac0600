"""The command line: the script `cordon`, and `python -m cordon`."""

import sys

from cordon.package_names import shadowed


def main() -> None:
    """Run the command line, unless it would run another distribution's modules; the import of cordon has said so."""
    if shadowed():
        sys.exit(2)
    from gcs.cli import main as run  # noqa: PLC0415 - never another distribution's

    run()


if __name__ == "__main__":
    main()
