"""The part of the command line that reads flight logs, and flies nothing."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from gcs.cli.options import (
    RESULT,
    Json,
    LogFile,
    Plot,
)
from gcs.errors import Exit

logs = App(
    name="log",
    help="What can be done with flight logs, beside flying.\n\nExample: cordon log layout -o cordon-layout.json",
)


def report(
    logs: Annotated[list[Path], Parameter(help="A flight's log, or several: one of each process of a flight.")],
    /,
    *,
    html: Annotated[Path | None, Parameter(group=RESULT, help="Write the report, a page for any browser.")] = None,
    compare: Annotated[
        Path | None, Parameter(group=RESULT, help="Show this log's flight beside the other, and what differs.")
    ] = None,
    json: Json = False,
    plot: Plot = None,
) -> Exit:
    """Evaluate a flight from its log: the metrics and verdicts, the paper's figures, and what happened.

    Example: cordon report flight.mcap --html flight.html
    """
    from gcs.cli.report_command import compare_flights, report_flight  # noqa: PLC0415

    if compare is not None:
        return compare_flights(logs, compare, json=json, html=html)
    return report_flight(logs, json=json, html=html, plot=plot)


def identify(
    logs: Annotated[list[Path], Parameter(help="Flight logs of one vehicle: .mcap, .ulg, .bin or .tlog.")],
    /,
    *,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], group=RESULT, help="The plant file to write, which must not exist yet."),
    ] = None,
    vehicle: Annotated[int | None, Parameter(help="The vehicle's system id, where logs hold several vehicles.")] = None,
    against: Annotated[
        list[str] | None,
        Parameter(negative="", help="Also tell the fit of this plant, bundled or a file; may be given again."),
    ] = None,
    json: Json = False,
    html: Annotated[Path | None, Parameter(group=RESULT, help="Write the figures, a page for any browser.")] = None,
) -> Exit:
    """Identify a vehicle from its flights: a plant with confidence intervals, and whether to fly by it.

    Example: cordon identify flight.ulg -o my-vehicle.toml --html my-vehicle.html
    """
    from gcs.cli.identify_command import identify_plant  # noqa: PLC0415

    return identify_plant(logs, output=output, vehicle=vehicle, against=against or [], json=json, html=html)


@logs.command
def recover(
    log: Annotated[Path, Parameter(help="A log that a killed process left, or that is damaged: it stays as it is.")],
    *,
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="Write here, in place of LOG-recovered.mcap; nothing is overwritten."),
    ] = None,
) -> Exit:
    """Make an unclosed or damaged log readable: copy all of it that is whole, and say what is not.

    Example: cordon log recover 2026-05-04_10-00-00-case2.mcap
    """
    from gcs.cli.log_commands import recover_log  # noqa: PLC0415

    return recover_log(log, output)


def replay(
    log: LogFile,
    *,
    json: Json = False,
    explain: Annotated[int | None, Parameter(help="Tell the story of this vehicle instead.")] = None,
    changes: Annotated[
        list[str] | None,
        Parameter(
            name="--set",
            negative="",
            help="Replay the filters instead, with another value: own_filter.KEY=VALUE or target_filter.KEY=VALUE, as "
            "in a mission file; may be given again.",
        ),
    ] = None,
) -> Exit:
    """Feed a recorded flight to fresh agents: every decision has to be what it was. Exit code 1 when one is not.

    Example: cordon replay flight.mcap --explain 2
    """
    from gcs.cli.log_commands import replay_log  # noqa: PLC0415

    return replay_log(log, json=json, explain=explain, changes=changes or [])


@logs.command
def layout(
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="The file to write, which must not exist yet.")
    ] = Path("cordon-layout.json"),
) -> Exit:
    """Write the layout by which Foxglove and Lichtblick show a flight: in 3-D, on a map, and in plots.

    Example: cordon log layout -o cordon-layout.json
    """
    from gcs.cli.log_commands import write_layout  # noqa: PLC0415

    write_layout(output)
    return Exit.HOLDS
