"""The command line: the script `cordon`, and `python -m cordon`."""

import sys

from cordon.package_names import shadowed


def main() -> None:
    """Run the command line, unless Python finds other modules of its names; the import of cordon has reported that."""
    if shadowed():
        sys.exit(2)
    from gcs.__main__ import main as run  # noqa: PLC0415 - never another distribution's

    run()


if __name__ == "__main__":
    main()
