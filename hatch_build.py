"""The build backend: hatchling, which compiles the floors of the tick into wheels (native_build.py).

With no C compiler, or where compiling fails, the wheel holds the sources alone. CORDON_COMPILE in the environment
decides otherwise: 0 never compiles, 1 makes a failure an error.
"""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import hatchling.build
from hatchling.build import *  # noqa: F403 - all hooks of the backend but the one below
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SETTING = os.environ.get("CORDON_COMPILE", "")
NEEDED = ["mypy[mypyc]>=1.15", "setuptools", "msgspec>=0.19", "numpy>=2"]
"""mypyc and the C compiler's driver, and the two libraries whose types mypyc reads."""


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return what building a wheel needs: mypyc only where it will compile. Editable wheels have another hook."""
    from native_build import no_compiler  # noqa: PLC0415

    compiles = SETTING != "0" and (SETTING or not no_compiler())
    return [*hatchling.build.get_requires_for_build_wheel(config_settings), *(NEEDED if compiles else [])]


class CustomBuildHook(BuildHookInterface[Any]):
    """Adds the compiled modules to a wheel, and to nothing else: an editable installation runs its sources."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile a copy of the sources, and name the modules to include."""
        if SETTING == "0" or version == "editable":
            return
        from native_build import compiled_copy  # noqa: PLC0415

        self._copy = TemporaryDirectory()  # removed with the hook, after the wheel is written
        directory = Path(self._copy.name)
        try:
            modules = compiled_copy(Path(self.root), directory)
        except (RuntimeError, OSError) as error:
            if SETTING:
                raise
            self.app.display_warning(f"cordon is not compiled, and a tick takes twice as long: {error}")
            return
        build_data["pure_python"], build_data["infer_tag"] = False, True
        build_data["force_include"].update({str(module): str(module.relative_to(directory)) for module in modules})
