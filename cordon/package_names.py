"""Detects packages of other distributions with the names of cordon's packages.

Other distributions also use the names `agents`, `gcs`, `estimation` and `sitl`. If one is installed beside cordon,
files of both share a folder, or Python finds only one of them. Every start of cordon checks this; it reads other
distributions' metadata only if there is a conflict.
"""

import os
import re
from importlib.util import find_spec

PACKAGES = ("agents", "estimation", "gcs", "sitl")
_ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - pathlib costs 10 ms
_METADATA = re.compile(r"cordon_gcs-.*\.dist-info")
_WAY_OUT = (
    "give cordon an environment of its own: `pipx install cordon-gcs`, `uv tool install cordon-gcs`, or a new `venv`"
)


def shadowed() -> list[str]:
    """Return a message for each of cordon's packages that Python imports from elsewhere, or does not find."""
    found = {name: _folder(name) for name in PACKAGES}
    return [
        f"Python imports {name!r} from {folder or 'nowhere'} and not from {_ROOT}, where cordon is. Remove the other "
        f"folder from Python's path. If another distribution is installed there, {_WAY_OUT}"
        for name, folder in found.items()
        if folder != os.path.join(_ROOT, name)  # noqa: PTH118
    ]


def shared() -> list[str]:
    """Return a message for each of cordon's packages whose folder contains another distribution's files."""
    crowded = _crowded()
    if not crowded:
        return []
    from importlib.metadata import packages_distributions  # noqa: PLC0415 - it reads the metadata of all

    owners = {name: {*packages_distributions().get(name, ())} - {"cordon-gcs"} for name in crowded}
    return [
        f"{', '.join(sorted(others))} and cordon-gcs both install {name!r} into {_ROOT}: files of one may have "
        f"replaced those of the other. Uninstall both, reinstall the one that you need here, and {_WAY_OUT}"
        for name, others in owners.items()
        if others
    ]


def _folder(name: str) -> str:
    """Return the folder in which Python finds a package, empty if it does not."""
    spec = find_spec(name)
    places = None if spec is None else spec.submodule_search_locations
    return os.path.realpath(next(iter(places))) if places else ""


def _crowded() -> list[str]:
    """Return the packages whose folders hold files that are not cordon's; none in a source tree."""
    known = _installed()
    return [name for name in PACKAGES if known and _here(name) != known[name]]


def _here(name: str) -> dict[str, str]:
    """Return the files in a package's own folder with their sizes, and its folders."""
    with os.scandir(os.path.join(_ROOT, name)) as entries:  # noqa: PTH118
        return {
            entry.name: str(entry.stat().st_size) if entry.is_file() else ""
            for entry in entries
            if entry.name != "__pycache__"
        }


def _installed() -> dict[str, dict[str, str]]:
    """Return the installed files with their sizes, by package, from cordon's RECORD; empty without one."""
    with os.scandir(_ROOT) as entries:
        records = [os.path.join(each.path, "RECORD") for each in entries if _METADATA.fullmatch(each.name)]  # noqa: PTH118
    known: dict[str, dict[str, str]] = {name: {} for name in PACKAGES}
    if not (records and os.path.exists(records[0])):  # noqa: PTH110
        return {}
    with open(records[0], encoding="utf-8") as lines:  # noqa: PTH123
        for line in lines:
            path, _, size = line.rstrip().rsplit(",", 2)
            package, _, rest = path.partition("/")
            name, _, inside = rest.partition("/")
            if package in known and name != "__pycache__":
                known[package][name] = "" if inside else size
    return known
