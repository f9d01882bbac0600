"""What is said of a log that cannot be used."""

from gcs.errors import InputError


class LogError(InputError):
    """A log cannot be read, or not as what it was meant to be; its faults name the file, and where in it and why."""
