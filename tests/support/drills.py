"""What tests of drills share."""

from gcs.drill.run import DrillRow


class Silent:
    """Shows no progress; implements `gcs.drill.run.Progress`."""

    def begin(self, step: str) -> None:
        pass

    def add(self, row: DrillRow) -> None:
        pass
