"""`cordon relay`: an emulated radio in front of any simulator."""

from dataclasses import dataclass, field
from typing import Annotated

from cyclopts import Parameter

from gcs.cli.options import Json
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

Radio = Annotated[
    str,
    Parameter(
        help="The radio: baud=57600, latency_ms=60, jitter_ms=30, loss=0.02, burst=3, noise=0.001, shared, "
        "buffer_bytes=2048, seed=1; separate several by commas.",
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RelayOptions:
    """Options of `cordon relay`."""

    station: Annotated[
        str,
        Parameter(help="The station's end: udpout://127.0.0.1:14540, or pty:PATH, a serial device that cordon opens."),
    ] = field(kw_only=False)
    vehicles: Annotated[
        tuple[str, ...],
        Parameter(help="Each vehicle's end: udpin://127.0.0.1:14640, or pty:PATH.", negative=""),
    ] = field(kw_only=False)
    radio: Radio
    json: Json = False


def relay(options: RelayOptions) -> Exit:
    """Emulate a radio between a station and vehicles: data rate, latency and losses of MAVLink. Ctrl-C ends it.

    Each end is a url as in a mission, or pty:PATH, which creates a serial device PATH for one program to open.

    Example: cordon relay udpout://127.0.0.1:14540 udpin://127.0.0.1:14640 --radio baud=57600,latency_ms=60,loss=0.02

    Example: cordon relay pty:/tmp/station pty:/tmp/px4-0 pty:/tmp/px4-1 --radio baud=115200,shared
    """
    hold_back()
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_problem
    from gcs.radio.emulation import Emulation
    from gcs.radio.serving import radio_spec, serve_until_ctrl_c

    spec = radio_spec(options.radio)
    if not options.vehicles:
        raise InputError(["vehicles: a radio needs at least one"])
    try:
        emulation = Emulation(spec, options.station, options.vehicles)
    except ValueError as error:
        raise InputError([f"{options.station} {' '.join(options.vehicles)}: {error}"]) from error
    except OSError as error:
        print_problem(f"the radio did not start: {error}", "end the program that uses this address, or use another")
        return Exit.REFUSED
    counts = serve_until_ctrl_c([emulation])
    if options.json:
        print_result(counts)
    return Exit.HOLDS
