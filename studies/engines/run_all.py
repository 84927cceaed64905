"""MuJoCo on the test set, beside schemes and solvers of this package.

    python studies/engines/run_all.py [--beside NAMES] [NAME ...]

prints the scorecard of all problems, or of those named. README.md has recorded results of more engines.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from recorded import recorded, run

import stiffbeam as sb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="problems of the test set")
    parser.add_argument("--beside", default="trapezoidal,moreau-jean,exact", help="solvers of this package")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        run(sys.executable, "mujoco_engine.py", Path(folder), given.names)
        rows = [recorded(Path(folder)), *filter(None, given.beside.split(","))]
        print(sb.score(rows, given.names or None, statistics=False))


if __name__ == "__main__":
    main()
