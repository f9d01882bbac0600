"""Messages are judged by the facts they tell - names, values, places - and not word for word."""


def facts_missing(text: str, *facts: str) -> list[str]:
    """Return the facts that a text does not hold, so that `facts_missing(...) == []` names them when it fails."""
    return [fact for fact in facts if fact not in text]
