"""Nothing that others have written makes a terminal do anything."""

from io import StringIO

from rich.table import Table
from rich.text import Text

from gcs.console.live import LiveView
from gcs.console.terminal import PrintableConsole
from gcs.console.vehicle_view import TeamRow

EVIL = "\x1b[2J\x1b]0;mine\x07\x9b31m\u202e"


def test_what_a_console_prints_is_printable_in_its_own_style() -> None:
    output = StringIO()
    console = PrintableConsole(file=output, force_terminal=True, color_system="standard", width=80)
    table = Table("name")
    table.add_row(Text(f"row {EVIL}", style="red"))
    console.print(table)
    console.print(f"two\nlines {EVIL}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    shown = output.getvalue()
    assert "row ?[2J?]0;mine?" in shown
    assert "two" in shown.splitlines()[-2]
    assert "\x1b[33m" in shown, "its own style"
    for harm in ("\x1b[2J", "\x1b]", "\x07", "\x9b", "\u202e"):
        assert harm not in shown


def test_live_tables_and_lines_are_printable() -> None:
    output = StringIO()
    view = LiveView(PrintableConsole(file=output, force_terminal=True, width=120))
    with view:
        view.update([TeamRow(1, tactic=f"tactic {EVIL}", mode="offboard", note=EVIL)], 1.0, EVIL, Text(EVIL))
        view.print_line(f"said {EVIL}")
    shown = output.getvalue()
    assert "said ?[2J" in shown
    for harm in ("\x1b[2J", "\x1b]", "\x07", "\x9b", "\u202e"):
        assert harm not in shown
