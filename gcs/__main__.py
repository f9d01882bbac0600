"""`python -m gcs` is `cordon`."""

from gcs.cli import main

main()
