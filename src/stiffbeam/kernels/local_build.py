"""The library of the kernels, compiled beside its sources where it is missing or older than they are."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

FLAGS = [
    "-std=c99",
    "-O3",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fopenmp-simd",
    "-fPIC",
    "-shared",
    "-fvisibility=hidden",
]
CLONES = '-DHOT=__attribute__((target_clones("avx2","default")))'  # AVX2 where the processor has it


@cache
def library() -> ctypes.CDLL:
    """The compiled kernels of this folder."""
    folder = Path(__file__).parent
    sources = sorted(folder.glob("*.c"))
    target = folder / "libkernels.so"
    newest = max(x.stat().st_mtime for x in [*sources, *folder.glob("*.h")])
    if not target.exists() or target.stat().st_mtime < newest:
        compiler = next((x for x in ("cc", "gcc", "clang") if shutil.which(x)), None)
        if compiler is None:
            raise OSError("The kernels of stiffbeam need a C compiler: install gcc or clang.")
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            made = os.path.join(scratch, target.name)
            for more in ([CLONES], []):
                command = [compiler, *FLAGS, *more, *map(str, sources), "-o", made, "-lm"]
                done = subprocess.run(command, capture_output=True, text=True)
                if done.returncode == 0:
                    break
            else:
                raise OSError(f"The kernels of stiffbeam do not compile: {done.stderr}")
            os.replace(made, target)
    return ctypes.CDLL(os.fspath(target))
