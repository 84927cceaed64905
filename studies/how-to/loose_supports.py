"""A tube in two loose supports under a measured force: how far is each answer known, and how fast does it wear?

    python studies/how-to/loose_supports.py

A steel tube of 19 x 1.5 mm and 1.2 m length is clamped at one end. Two supports leave it 0.3 mm of play to either
side. The script writes a record and a case file with ranges, prints the uncertainty of every quantity on a coarse mesh
and on a fine one, and the rates of impacts and of work at each support. The sliding at a support is the slope of the
tube times its outer radius; there is no friction. On the command line: stiffbeam doubt tube.toml
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import stiffbeam as sb

CASE = """[[case]]
name = "tube"
cells = 8
dt = 2e-5
t_end = 0.1
runs = ["HHT(alpha=-0.1)"]
[case.problem]
units = { length = "m", time = "s", force = "N" }
length = 1.2                # m
stiffness = 668.0           # N m2, 210 GPa times pi (0.019^4 - 0.016^4)/64 m4
mass_per_length = 0.647     # kg/m
viscosity = 0.15            # N m2 s, 1 % of critical damping in the first mode
stops = [
    { position = 0.6, lower = -3e-4, upper = 3e-4, stiffness = 1e6 },
    { position = 1.2, lower = -3e-4, upper = 3e-4, stiffness = 1e6 },
]
loads = [{ position = 0.9, sampled = "force.csv", kind = "cubic" }]
[case.uncertain]
stiffness = [661, 675]      # 1 % to either side
"stops[0].upper" = [285e-6, 315e-6]
"loads[0].time.scale" = [0.98, 1.02]
"""

if __name__ == "__main__":
    t = np.arange(0.0, 0.1001, 5e-4)
    force = 12.0 * np.sin(2 * np.pi * 22.0 * t) + 6.0 * np.sin(2 * np.pi * 61.0 * t + 1.0)
    np.savetxt("force.csv", np.column_stack([t, force]), delimiter=",", header="time (s),force (N)", comments="")
    Path("tube.toml").write_text(CASE, encoding="utf-8")
    case = sb.load_cases("tube.toml")["tube"]
    for cells in (4, 8):
        print(f"{cells} cells\n{sb.study('doubt', replace(case, cells=cells), members=8)}\n")
    # Rows of the slope at nodes 4 and 8, by central and one-sided differences; entry k - 1 is u at node k.
    rows = 0.0095 / 0.15 * np.array([[0, 0, -0.5, 0, 0.5, 0, 0, 0], [0, 0, 0, 0, 0, 0, -1.0, 1.0]])
    exact = sb.reference(case.system(), case.t_end)
    print(sb.contact_rates(exact, tangents=list(rows)))
    other = sb.reference(case.system(), case.t_end, "dop853", rtol=1e-9)
    for one, same in zip(exact.contacts, other.contacts, strict=True):
        assert np.max(np.abs(one.impacts.times - same.impacts.times)) < 1e-6  # s
