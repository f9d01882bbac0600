"""Text from others without control characters, which a terminal would execute."""

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.segment import Segment

from agents.team.text import printable


def printable_lines(text: str) -> str:
    """Return a text with '?' for each control character but line ends."""
    return "\n".join(map(printable, text.split("\n")))


class Printable:
    """A rich renderable with its text made printable; styles and rich's own control codes stay."""

    def __init__(self, renderable: ConsoleRenderable) -> None:
        self._renderable = renderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render it."""
        for segment in console.render(self._renderable, options):
            text, style, control = segment
            yield segment if control else Segment(printable_lines(text), style)


class PrintableOutput(RenderHook):
    """Makes all output of a console printable."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        """See RenderHook."""
        return [Printable(each) for each in renderables]
