"""Sizes of the installed packages, and modules that are loaded at each moment.

    python studies/weight.py        # writes both tables into studies/guide/weight.md

Sizes are those of the files that each distribution lists. Loaded modules are counted in a fresh Python.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import distributions
from pathlib import Path

PAGE = Path(__file__).parent / "guide" / "weight.md"

SERVES = {
    "everything": ("numpy",),
    "compiled loops: time stepping, ensembles, exact solution": ("numba", "llvmlite"),
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
    "`import stiffbeam`": "import stiffbeam",
    "`sb.Stops(...)`, a model": "import stiffbeam as sb; sb.Stops(upper=0.1, stiffness=1.0)",
    "`sb.semidiscretise`, the name": "import stiffbeam as sb; sb.semidiscretise",
    "`sb.integrate`, the name": "import stiffbeam as sb; sb.integrate",
    "`sb.reference`, the name": "import stiffbeam as sb; sb.reference",
    "`stiffbeam --help`": "sys.argv = ['stiffbeam', '--help']; import stiffbeam.cli; stiffbeam.cli.main()",
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


def loaded(code: str) -> tuple[int, list[str]]:
    """(modules, the heavy libraries among them) of ``code`` in a fresh Python, itself not counted."""
    program = (
        "import sys, io, contextlib; before = set(sys.modules)\n"
        f"with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): exec({code!r})\n"
        "new = set(sys.modules) - before; print(len(new), *sorted({m.partition('.')[0] for m in new}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    count, *tops = done.stdout.split()
    return int(count), [name for name in WATCHED if name in tops]


def tables() -> str:
    """Return both tables as Markdown."""
    sizes = megabytes()
    lines = ["| serves | packages | MB |", "|---|---|---|"]
    weights = {purpose: [name for name in names if name in sizes] for purpose, names in SERVES.items()}
    for purpose, names in sorted(weights.items(), key=lambda item: -sum(sizes[name] for name in item[1])):
        lines.append(f"| {purpose} | {', '.join(names)} | {sum(sizes[name] for name in names):.0f} |")
    lines += ["", "Modules loaded at each moment, in a fresh Python:", ""]
    lines += ["| moment | modules | large ones among them |", "|---|---|---|"]
    for moment, code in MOMENTS.items():
        count, heavy = loaded(code)
        lines.append(f"| {moment} | {count} | {', '.join(heavy) or 'none'} |")
    return "\n".join(lines)


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    begun, end = "<!-- made by studies/weight.py -->", "<!-- end -->"
    before, after = text.partition(begun)[0], text.partition(end)[2]
    PAGE.write_text(f"{before}{begun}\n\n{tables()}\n\n{end}{after}", encoding="utf-8")
