"""Build backend: hatchling, which compiles the kernels to one shared library, for all versions of Python.

Only where the machine has no C compiler is one asked for, as a wheel (ziglang).
"""

from __future__ import annotations

import sysconfig
from typing import Any

import compile as compilation  # by backend-path: without the package and what it imports
from hatchling.build import *  # noqa: F403
from hatchling.build import get_requires_for_build_editable as editable_requirements
from hatchling.build import get_requires_for_build_wheel as wheel_requirements
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SETTINGS = dict[str, Any] | None
COMPILER = [] if compilation.compiler() else ["ziglang==0.16.0"]


def get_requires_for_build_wheel(config_settings: SETTINGS = None) -> list[str]:
    """Requirements of a wheel."""
    return [*wheel_requirements(config_settings), *COMPILER]


def get_requires_for_build_editable(config_settings: SETTINGS = None) -> list[str]:
    """Requirements of an editable installation."""
    return [*editable_requirements(config_settings), *COMPILER]


class Kernels(BuildHookInterface[Any]):
    """Compile the kernels next to their sources, and put the library into the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See hatchling: called before a wheel is put together."""
        library = compilation.build()
        build_data["pure_python"] = False
        # No part of Python's API is used: one wheel for all its versions.
        build_data["tag"] = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["artifacts"].append(library.relative_to(self.root).as_posix())
