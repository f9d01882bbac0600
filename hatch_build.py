"""Compile the floors of the tick into a wheel where CORDON_COMPILE is set in the environment (native_build.py)."""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

REQUESTED = os.environ.get("CORDON_COMPILE", "") not in ("", "0")
NEEDED = ["mypy[mypyc]>=1.15", "setuptools"]


class CustomBuildHook(BuildHookInterface[Any]):
    """Adds the compiled modules to a wheel on request, and to nothing else: an editable install runs its sources."""

    def dependencies(self) -> list[str]:
        """Return what compiling needs: mypyc, and what the modules import, whose types it reads."""
        return [*NEEDED, *self.metadata.core.dependencies] if REQUESTED else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile a copy of the sources, and name the modules to include."""
        if not REQUESTED or version == "editable":
            return
        sys.path.insert(0, self.root)
        from native_build import compiled_copy  # noqa: PLC0415

        self._copy = TemporaryDirectory()  # removed with the hook, after the wheel is written
        directory = Path(self._copy.name)
        modules = compiled_copy(Path(self.root), directory)
        build_data["pure_python"], build_data["infer_tag"] = False, True
        build_data["force_include"].update({str(module): str(module.relative_to(directory)) for module in modules})
