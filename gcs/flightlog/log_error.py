"""The error of a log that cannot be used."""

from gcs.errors import InputError


class LogError(InputError):
    """A log cannot be read, or lacks what is needed; its faults name the file, the place in it, and the reason."""
