"""`python -m gcs` is `cordon`."""

from gcs.cli.app import main

main()
