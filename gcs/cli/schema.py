"""`cordon schema`: the JSON Schema of mission files."""

from gcs.errors import Exit


def schema() -> Exit:
    """Print the JSON Schema of mission files, for completion and checks in editors.

    Example: cordon schema
    """
    from json import dumps

    from gcs.cli.output import print_result
    from gcs.mission.sections import mission_schema

    print_result(dumps(mission_schema(), indent=2))
    return Exit.HOLDS
