"""Sizes of the installed packages, and modules that are loaded at each moment.

    python studies/weight.py

Sizes are those of the files that each distribution lists. Loaded modules are counted in a fresh Python.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import distributions

SERVES = {
    "everything": ("numpy",),
    "compiled loops: march, ensembles, exact solution": ("numba", "llvmlite"),
    "matrices, eigenvalues; DOP853, Radau, LSODA": ("scipy",),
    "Kvaerno methods": (
        "jax", "jaxlib", "diffrax", "equinox", "optimistix", "lineax", "jaxtyping", "ml-dtypes", "opt-einsum",
        "wadler-lindig",
    ),
    "SUNDIALS: CVODE and IDA": ("scikit-sundae",),
    "multiprecision": ("python-flint",),
    "netCDF files, DataFrames": ("xarray", "h5netcdf", "h5py", "pandas", "python-dateutil", "tzdata", "packaging"),
    "pictures": ("matplotlib", "pillow", "fonttools", "contourpy", "kiwisolver", "cycler", "pyparsing"),
    "pages": ("jinja2", "markupsafe"),
    "the command": ("typer", "rich", "click", "pygments", "markdown-it-py", "mdurl", "shellingham", "platformdirs"),
}  # fmt: skip
MOMENTS = {
    "import stiffbeam": "import stiffbeam",
    "sb.Stops, a model": "import stiffbeam as sb; sb.Stops(upper=0.1, stiffness=1.0)",
    "sb.semidiscretise": "import stiffbeam as sb; sb.semidiscretise",
    "sb.integrate": "import stiffbeam as sb; sb.integrate",
    "sb.reference": "import stiffbeam as sb; sb.reference",
    "stiffbeam --help": "import stiffbeam.cli; stiffbeam.cli.app(['--help'], standalone_mode=False)",
}
WATCHED = (
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "matplotlib",
    "xarray",
    "pandas",
    "jax",
    "diffrax",
    "sksundae",
    "flint",
)


def megabytes() -> dict[str, float]:
    """Size of every installed distribution, by its normalised name."""
    found = {}
    for one in distributions():
        sizes = (file.locate() for file in one.files or [])
        found[one.metadata["Name"].lower().replace("_", "-")] = (
            sum(p.stat().st_size for p in sizes if p.is_file()) / 1e6
        )
    return found


def loaded(code: str) -> tuple[int, list[str], float]:
    """(modules, the heavy libraries among them, seconds) of ``code`` in a fresh Python, itself not counted."""
    program = (
        "import sys, time, io, contextlib; before = set(sys.modules); begun = time.perf_counter()\n"
        f"with contextlib.redirect_stdout(io.StringIO()): exec({code!r})\n"
        "seconds = time.perf_counter() - begun\n"
        "new = set(sys.modules) - before; print(len(new), seconds, *sorted({m.partition('.')[0] for m in new}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    count, seconds, *tops = done.stdout.split()
    return int(count), [name for name in WATCHED if name in tops], float(seconds)


def main() -> None:
    sizes = megabytes()
    print("| serves | packages | MB |\n|---|---|---|")
    for purpose, names in SERVES.items():
        here = [name for name in names if name in sizes]
        print(f"| {purpose} | {', '.join(here)} | {sum(sizes[name] for name in here):.0f} |")
    print("\n| moment | modules | of them heavy | seconds |\n|---|---|---|---|")
    for moment, code in MOMENTS.items():
        count, heavy, seconds = loaded(code)
        print(f"| `{moment}` | {count} | {', '.join(heavy) or 'none'} | {seconds:.2f} |")


if __name__ == "__main__":
    main()
