"""Which starts does a scheme send to the wrong motion?

    python studies/how-to/basins.py                # prints the table, six seconds
    python studies/how-to/basins.py basins.png     # draws a picture too, of more starts

A driven mass with a stop has two attractors: a motion that misses the stop, and one that hits it in every second
period. Where a motion ends depends on its start. The script follows a grid of starts by the exact solution and by
schemes. Each ends on the one attractor or the other, since it hits the stop in the last periods or does not. The table
has the share of starts that end on another attractor than the exact motion does.
"""

import sys

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

import stiffbeam as sb

PERIOD, PERIODS, LAST = 2.0 * np.pi / 2.6, 150, 4  # of the drive; in all, and those in which impacts decide
PLACES, SPEEDS, SIDE = (-3.0, 0.5), (-3.0, 3.0), 30 if len(sys.argv) > 1 else 14
METHODS = (
    (sb.HHT(alpha=-0.1), "implicit"),
    (sb.BDF2(), "implicit"),
    (sb.SDIRK(), "implicit"),
    (sb.Trapezoidal(), "implicit"),
    (sb.Trapezoidal(), "conserving"),
    (sb.ExponentialFlow(), "conserving"),
)

if __name__ == "__main__":
    load = ([1.0], sb.Harmonic(amplitude=0.7, frequency=2.6))
    stop = sb.Contact([1.0], sb.Stops(upper=PLACES[1], stiffness=100.0))
    system = sb.System.from_matrices([[1.0]], [[1.0]], [[0.08]], loads=[load], contacts=[stop])
    q, v = np.meshgrid(np.linspace(*PLACES, SIDE), np.linspace(*SPEEDS, SIDE))
    starts = sb.varied_members(system, {"initial_displacement[0]": q, "initial_velocity[0]": v})
    end, since = PERIODS * PERIOD, (PERIODS - LAST) * PERIOD
    hits = {"exact": sb.reference_ensemble(system, end, starts, since=since).contacts[0].impact_count > 0}
    print(f"{np.mean(hits['exact']):.1%} of the starts end on the motion that hits the stop")
    wrong = {}
    for scheme, contact in METHODS:
        for steps in (50, 100, 200, 400):  # in a period
            runs = sb.integrate_ensemble(system, scheme, PERIOD / steps, end, starts, contact=contact, since=since)
            hits[f"{scheme}, {contact}, {steps}"] = ends = runs.contacts[0].impact_count > 0
            wrong[scheme, contact, steps] = np.mean(ends != hits["exact"])
        print(f"{scheme!s:20} {contact:11}", *(f"{wrong[scheme, contact, n]:8.2%}" for n in (50, 100, 200, 400)))
    assert all(wrong[scheme, contact, 400] < 0.5 * wrong[scheme, contact, 50] for scheme, contact in METHODS)
    if len(sys.argv) > 1:
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        shown = ("exact", "HHT(alpha=-0.1), implicit, 50", "BDF2, implicit, 50")
        for axis, name in zip(figure.subplots(1, 3, sharey=True), shown, strict=True):
            colours = ListedColormap(["white", "0.45", "#fdb863", "#b35806"])  # without impacts, with; wrong: the same
            ends = hits[name] + 2 * (hits[name] != hits["exact"])
            axis.imshow(ends.reshape(SIDE, SIDE), colours, vmin=0, vmax=3, origin="lower", extent=(*PLACES, *SPEEDS))
            axis.set(title=name, xlabel="initial position", ylabel="initial velocity", aspect="auto")
        figure.savefig(sys.argv[1], dpi=100)
