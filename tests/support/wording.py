"""Tests compare the facts in messages - names, values, paths - not the wording."""


def facts_missing(text: str, *facts: str) -> list[str]:
    """Return the facts that a text does not contain, so that a failing `facts_missing(...) == []` names them."""
    return [fact for fact in facts if fact not in text]
