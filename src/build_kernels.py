"""Build hook of hatchling: the kernels as one shared library, for all versions of Python."""

from __future__ import annotations

import runpy
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# By its path: without the package and what it imports.
COMPILE = runpy.run_path(str(Path(__file__).parent / "stiffbeam" / "kernels" / "compile.py"))


class Kernels(BuildHookInterface[Any]):
    """Compile the kernels next to their sources, and put the library into the wheel."""

    def dependencies(self) -> list[str]:
        """A compiler as a wheel, only where the machine has none."""
        return [] if COMPILE["compiler"]() else ["ziglang==0.16.0"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling: called before a wheel is put together."""
        library = COMPILE["build"]()
        build_data["pure_python"] = False
        # No part of Python's API is used: one wheel for all its versions.
        build_data["tag"] = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["artifacts"].append(library.relative_to(self.root).as_posix())
