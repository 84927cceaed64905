"""Impulse and energy lost on stiff stops, at the step of the paper and at a tenth of it.

    python studies/stiff_stops.py

The rows are those of ``stiffbeam rigid-beam table10``. A range is that over time steps within 2 % of the one stated:
differences inside it are chance. Negative losses are gains.
"""

import numpy as np

import stiffbeam as sb

STIFFNESS = (5e6, 1e9, np.inf)  # the paper's, and two stiffer ones


def spread(low: float, high: float, digits: int) -> str:
    """Return the text of a range, of one number if both ends are the same."""
    ends = [f"{float(f'{x:.{digits}g}') if abs(x) > 1e-9 else 0.0:g}" for x in (low, high)]
    return " to ".join(dict.fromkeys(ends))


if __name__ == "__main__":
    rows = sb.study("rigid-beam", "table10").to_dataframe().fillna({"kappa": np.inf})
    print(f"cells  kappa  step   {'impulse':12}  {'energy lost, %':18}  {'impacts':8}  method")
    for row in rows[rows.kappa.isin(STIFFNESS)].sort_values(["cells", "kappa"], kind="stable").itertuples():
        law = f", e = {row.restitution:g}" if row.restitution >= 0.0 else ""
        impulse = spread(row.impulse_low, row.impulse_high, 3)
        lost = spread(100.0 * row.lost_low, 100.0 * row.lost_high, 2)
        impacts = spread(row.impacts_low, row.impacts_high, 3)
        step = f"{row.dt:g}" if row.dt else "exact"
        print(f"{row.cells:5}  {row.kappa:5.0e}  {step:5}  {impulse:12}  {lost:18}  {impacts:8}  {row.method}{law}")
