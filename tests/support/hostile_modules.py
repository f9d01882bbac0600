"""A folder from elsewhere: it holds modules with the names of cordon's and of Python's, which leave a mark."""

from pathlib import Path

MODULES = ("json", "multiprocessing", "numpy", "sitecustomize", "socket", "zenoh")
PACKAGES = ("agents", "gcs")


def write_modules(folder: Path) -> None:
    """Write them."""
    marks = f"import os\nopen({str(_marker(folder))!r}, 'a').write(f'{{__name__}} in {{os.getpid()}}\\n')\n"
    for name in MODULES:
        (folder / f"{name}.py").write_text(marks, encoding="utf-8")
    for name in PACKAGES:
        (folder / name).mkdir()
        for file in ("__init__.py", "__main__.py"):
            (folder / name / file).write_text(marks, encoding="utf-8")


def imported(folder: Path) -> str:
    """Return which of them were imported, by which processes; empty if none was."""
    marker = _marker(folder)
    return marker.read_text(encoding="utf-8") if marker.exists() else ""


def _marker(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}-imported")
