"""Compilation of the C sources of this folder to one shared library. The build hook runs this file by itself, without
the package or NumPy."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).parent
# -O2 is 1.8 times slower. Never -ffast-math: infinite stops, NaN and compensated sums would vanish, without a warning.
FLAGS = [
    "-std=c99", "-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd", "-fPIC",
    "-shared", "-fvisibility=hidden",
]  # fmt: skip
# The hot loops a second time for the vector registers of today's processors, chosen at load; for compilers that can.
CLONES = [f'-DHOT=__attribute__((target_clones("{target}","default")))' for target in ("arch=x86-64-v3", "avx2")]


def sources() -> list[Path]:
    """C files and headers; an installed package has the headers alone, for the structures that they declare."""
    return sorted([*FOLDER.glob("*.c"), *FOLDER.glob("*.h")])


def library_path() -> Path:
    """The library of these sources. Its name has a digest of them, so that an older one is never loaded."""
    texts = sources()
    if not any(text.suffix == ".c" for text in texts):
        return next(FOLDER.glob("kernels-*.so"), FOLDER / "kernels.so")
    digest = hashlib.sha256(" ".join([sysconfig.get_platform(), *FLAGS, *CLONES]).encode())
    for text in texts:
        digest.update(text.read_bytes())
    return FOLDER / f"kernels-{digest.hexdigest()[:12]}.so"


def compiler() -> list[str] | None:
    """The compiler named by CC, or the first of cc, gcc, clang and ziglang that is there."""
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    found = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
    if found is not None:
        return [found]
    # Without -mcpu it would compile for the processor at hand alone.
    zig = [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
    return zig if importlib.util.find_spec("ziglang") is not None else None


def build(target: Path | None = None, more: Sequence[str] = ()) -> Path:
    """Compile the sources to ``target``, by default ``library_path()``. Raises ImportError where that is not possible.

    Two processes may build the same library: each writes a file of its own, which then takes the place of the target.
    """
    path = target or library_path()
    command = compiler()
    if command is None:
        raise ImportError("The kernels of stiffbeam need a C compiler: install gcc or clang, or `pip install ziglang`.")
    files = [str(x) for x in sources() if x.suffix == ".c"]
    clones = CLONES if platform.machine() in ("x86_64", "AMD64") else []
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = os.path.join(folder, path.name)
        message = ""
        for hot in [*([x] for x in clones), []]:
            whole = [*command, *FLAGS, *hot, *more, "-o", made, *files, "-lm"]
            done = subprocess.run(whole, capture_output=True, text=True)
            if done.returncode == 0:
                break
            message = done.stderr.strip()
        else:
            raise ImportError(f"The kernels of stiffbeam do not compile with {shlex.join(command)}: {message}")
        os.replace(made, path)
    return path
