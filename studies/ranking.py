"""Does the paper's ranking, HHT first, hold at equal error?

    python studies/ranking.py

The paper ranks by CPU seconds at one step (Tables 10 to 13: HHT against SDIRK-OS). Here every scheme gets the
step it needs: the seconds to a tip error of 1e-3 and of 1e-4 through the first impacts, and how long its
impacts follow the exact ones at the finest step tried.
"""

import numpy as np
from stiffbeam.studies.precision import cheapest

from stiffbeam.studies import study

ERRORS = (1e-3, 1e-4)

if __name__ == "__main__":
    first: list[str] = []
    for table in ("table10", "table11", "table12", "table13"):
        out = f"stiffbeam-output/{table}"
        records = study("precision", table, folder=f"{out}/journal", methods=["exact"])
        records.save(out)
        schemes = [row for row in records.rows if row["method"] != "exact"]
        for error in ERRORS:
            ranked = cheapest(schemes, error, "seconds")
            print(f"{table}, error {error:g}: " + ", ".join(f"{name} {1e3 * cost:.2g} ms" for cost, name in ranked))
            first += [name.removesuffix(" at most") for _, name in ranked[:1]]
        tracked = {row["method"]: row["tracked"] for row in schemes}  # the finest step is the last
        best = max(tracked, key=lambda name: tracked[name] if np.isfinite(tracked[name]) else 0.0)
        print(f"{table}, longest: {best} to t = {tracked[best]:.3g} of {schemes[0]['horizon']:.3g}")
    counts = {name: first.count(name) for name in dict.fromkeys(first)}
    print("First at equal error: " + ", ".join(f"{name} {count} of {len(first)}" for name, count in counts.items()))
