"""Does the paper's ranking, HHT first, hold at equal error?

    python studies/how-to/ranking.py            # the four tables, a minute
    python studies/how-to/ranking.py table10

The paper ranks by CPU seconds at one step (Tables 10 to 13: HHT against SDIRK-OS). Here every scheme gets the
step it needs: the seconds to a tip error of 1e-3 and of 1e-4 through the first impacts, and how long its
impacts follow the exact ones at the finest step tried.
"""

import sys
from collections import Counter
from typing import Any

from stiffbeam.schemes import SCHEMES
from stiffbeam.studies import study
from stiffbeam.studies.converge import cheapest

ERRORS = (1e-3, 1e-4)

if __name__ == "__main__":
    first: Counter[str] = Counter()
    longest = []
    tables = sys.argv[1:] or ["table10", "table11", "table12", "table13"]
    for table in tables:
        out = f"stiffbeam-output/{table}"
        options: dict[str, Any] = {
            "kinds": ["contact"],
            "integrators": list(SCHEMES),
            "views": ["time", "matched"],
            "halvings": 8,
        }
        records = study("converge", table, folder=f"{out}/points", **options)
        records.save(out)
        for error in ERRORS:
            ranked = sorted(cheapest(records.found, error, "seconds").items(), key=lambda each: each[1])
            print(f"{table}, error {error:g}: " + ", ".join(f"{name} {1e3 * cost:.2g} ms" for name, cost in ranked))
            first.update(name for name, _ in ranked[:1])
        finest = records.found.sort_values("dt").groupby("integrator").first()
        best = finest.matched_until.idxmax()
        longest.append(best)
        print(f"{table}, longest: {best} to t = {finest.matched_until[best]:.3g} of {finest.horizon[best]:.3g}")
    of = f"of {len(tables) * len(ERRORS)}"
    print("First at equal error: " + ", ".join(f"{name} {count} {of}" for name, count in first.items()))
    assert "HHT(alpha=-0.1)" not in longest
