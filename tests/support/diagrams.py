"""The tables of transitions as Mermaid state diagrams."""

from agents import tactics
from agents.shell import life


def tactic_diagram() -> str:
    """Return the table of tactics as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {tactics.Tactic.STANDBY.value}"]
    lines += [
        f"    {before.value} --> {after.value}: {event.value}" for (before, event), after in tactics.TRANSITIONS.items()
    ]
    lines.append(f"    {tactics.Tactic.LAND.value} --> [*]")
    return "\n".join(lines)


def life_diagram() -> str:
    """Return the table of an agent's life as a Mermaid state diagram; two phases have one arrow with all events."""
    arrows: dict[tuple[life.Phase, life.Phase], list[str]] = {}
    for (before, event), (after, _) in life.TRANSITIONS.items():
        arrows.setdefault((before, after), []).append(event.value)
    lines = ["stateDiagram-v2", f"    [*] --> {_identifier(life.Phase.GROUND)}"]
    lines += [f"    {_identifier(phase)}: {phase.value}" for phase in life.Phase]
    lines += [
        f"    {_identifier(before)} --> {_identifier(after)}: {', '.join(events)}"
        for (before, after), events in arrows.items()
    ]
    lines.append(f"    {_identifier(life.Phase.ENDED)} --> [*]")
    return "\n".join(lines)


def _identifier(phase: life.Phase) -> str:
    return phase.name.lower()
