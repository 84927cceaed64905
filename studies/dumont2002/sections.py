"""The sections of the page that stand in front of and behind the tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stiffbeam.files.cases import paper_cases
from stiffbeam.measures.peaks import EXCITED
from stiffbeam.schemes import Scheme

from . import html as h
from .costs import CPU_TABLES
from .ensembles import PERIODS, PERTURBATION, Numbers
from .evidence import Evidence
from .judges_motions import lines, named
from .no_contact import CELLS, DT, STIFFNESS, T_END
from .reading import Reading
from .table_section import spread
from .typeset import DASH, percent, short, typeset, written

DOI = "10.1016/S0378-4754(02)00003-4"  # by the number printed at the foot of its first page
CITATION = h.joined(
    "Y. Dumont, Vibrations of a beam between stops: numerical simulations and comparison of several numerical "
    "schemes, Math. Comput. Simul. 60 (2002) 45–83, ",
    h.element("a", f"doi:{DOI}", href=f"https://doi.org/{DOI}"),
    ".",
)


def punch_line(numbers: Mapping[int, Numbers], close_up: Path, shares: Path) -> h.Html:
    """What the paper could not see."""
    ten = numbers[10]
    exact, runs = ten["exact"]["displacement"], ten["runs"]
    share = typeset(f"{spread(exact, 'fraction', 100.0)} %")
    touched = ", ".join(f"{spread(row, 'fraction', 100.0)} % with {_SCHEME[name]}" for name, row in runs.items())
    touched = typeset(touched)
    known = typeset(f" (the true motion to T for {percent(exact['fraction'])})") if exact["digits"] else ""
    fast = ", ".join(f"{spread(row, 'fast')} with {_SCHEME[name]}" for name, row in runs.items())
    return h.joined(
        h.paragraph(
            f"In the motion of Table 10 the beam touches a stop for {share} of the time{known}."
            f" The schemes of the paper, at its step, touch it for {touched}. Most of what its figures show as "
            "resting on the stop is numerical dissipation: the schemes take away the fast motion that throws the tip "
            "off again.",
            class_="lead",
        ),
        h.figure(
            [
                h.image(
                    close_up,
                    "Tip displacement of Table 10 near the upper stop, inside the horizon: the exact motion, and the "
                    f"schemes. They touch the stop for {touched} of the time, the exact motion for "
                    f"{share}.",
                )
            ],
            "Table 10 at the upper stop, inside the horizon. Look at the black curve between the stop and 0.09: it "
            f"is the solution of the same equations{', known to nine digits' if exact['digits'] else ''}. Its fast "
            f"motion (rms tip velocity above the second natural frequency) is {spread(exact, 'fast')}; {fast}.",
            "one",
        ),
        h.figure(
            [
                h.image(
                    shares,
                    "Share of time in contact, one row per table, mean and deviation of the ensembles: the exact "
                    f"motions between {_extreme(numbers, min)} and {_extreme(numbers, max)} %, and the schemes.",
                )
            ],
            f"Share of time in contact over {PERIODS} drive periods or more, mean and standard deviation of the "
            "ensembles. Look at the distance from the diamonds (exact) to the other marks: that part of the contact is "
            "made by the scheme.",
            "one",
        ),
    )


def _extreme(numbers: Mapping[int, Numbers], which: Callable[[list[float]], float]) -> str:
    means = [
        float(np.mean([x for members in row["ensemble"].values() for x in members["fraction"]]))
        for found in numbers.values()
        for row in found["exact"].values()
    ]
    return f"{100 * which(means):.2g}"


_SCHEME = {
    "(4.13)": "HHT", "(4.14)": "SDIRK (4.14)", "(4.5)": "BDF2 (4.5)", "(4.11)": "BDF2 (4.11)", "(4.10)": "SDIRK (4.10)",
    "(4.12)": "SDIRK (4.12)",
}  # fmt: skip


def how_read(reading: Reading) -> h.Html:
    """What the paper leaves open, and what is taken here."""
    contact = (
        "implicit: every stage solves for the displacement and the force of the stop together, in closed form. The "
        "paper linearises instead; --contact extrapolated does that."
        if reading.contact == "implicit"
        else "extrapolated: the force is that of a position predicted from known values, as the paper describes it."
    )
    schemes = (
        "as printed: (4.13) with unweighted load and contact, σ with the printed sign. BDF2 has no misprint that runs."
        if reading.printed
        else "corrected. --printed takes (4.13) and σ as printed; stiffbeam errata says what each misprint costs."
    )
    exact = (
        "multiprecision solutions of the same semi-discrete equations, to 10⁻⁹ of the motion over the whole span: "
        "these are called true."
        if reading.references
        else "the exact solution of the same semi-discrete equations in float64. Past the horizon it is one "
        "realisation of the motion, drawn as dots, and nothing is called true; --references takes "
        "multiprecision solutions."
    )
    return h.definition_list(
        [
            ("End times", "never stated. Taken from the ratios of HHT's CPU times and the time axis of Fig. 2c; T "
            "stands with each "
             "table. SDIRK's CPU times and the impact counts fit no such choice, and nothing was tuned to them."),
            ("Initial data", "never stated. At rest: u₀ = 0, v₀ = 0."),
            ("Parameters", "read as the decimals that the paper prints. A float64 computation uses the doubles next to "
            "them, which is another motion past the horizon."),
            ("Contact", contact),
            ("Schemes", schemes),
            ("The exact motion", exact),
            ("Horizon", "motions between stops are chaotic: solutions that differ in the sixteenth digit diverge "
             "after a few dozen impacts. The horizon is the time to which float64 can follow the exact motion. Errors "
             "are measured up to it; past it (grey in the figures) a run is one realisation, and only statistics mean "
             "something."),
            ("Ensembles", f"two of every scheme and of the exact motion, from seeds that share no member, over "
             f"{PERIODS} drive periods or more. Their members differ at the start by {written(PERTURBATION)} of the "
             "motion; ± is one standard deviation of a member. A statement counts as decided outside three standard "
             "errors (Student's t), and its verdict stands if neither ensemble alone says otherwise."),
            ("Impact", "a step in contact whose predecessor was not, the paper's rule; impacts of the exact motion are "
             "counted by events."),
        ],
        "reading",
    )  # fmt: skip


def no_contact(pictures: Sequence[Path], curves: Mapping[str, Mapping[str, float]]) -> h.Html:
    """The section of errors without contact: pictures and a table."""
    rows = [
        [name, typeset(f"{row['error']:.1e}"), typeset(f"{row['in_time']:.1e}") if row["in_time"] else "–"]
        for name, row in curves.items()
    ]
    return h.joined(
        h.paragraph(
            f"u = X₁(x) sin 2t, k² = {STIFFNESS:g}, h = {1 / CELLS:g}, dt = {DT:g}. The paper gives no end time; "
            f"here T = {T_END:g}. SDIRK with γ = 0.4359, HHT with α = −0.1."
        ),
        h.figure(
            [
                h.image(pictures[0], "Error at the tip against time: every scheme lies on the curve of its grid."),
                h.image(pictures[1], "The part of the error that the schemes add: at least a factor of 50 smaller."),
            ],
            "Left, the error against the exact solution: look at how every scheme lies on the curve of its "
            "discretisation in space (grey), so that this test compares grids, not schemes. Right, what the schemes "
            "themselves add.",
        ),
        h.table(
            ["curve", "largest error", "of it the scheme's"], rows, "Section 5.1: largest errors at the tip over X₁(1)"
        ),
    )


def impacts(numbers: Mapping[int, Numbers]) -> h.Html:
    """The paper's counts, the ensembles', and the true ones where they are known."""
    known = any(row["digits"] for found in numbers.values() for row in found["exact"].values())
    rows = []
    for table, found in numbers.items():
        case = paper_cases()[f"table{table}"]
        published = case.published.get("impacts", {})
        for equation, row in found["runs"].items():
            exact = found["exact"][row["form"]]
            label = next(f"{s}@{f}" for s, f in case.runs if f == row["form"] and _same(equation, s, f))
            other = row["other contact"]
            rows.append(
                [
                    f"{table} {equation}", short(published.get(label)), spread(row, "impacts"),
                    "overflow" if "failed" in other else short(other["impacts"]),
                    spread(exact, "impacts"),
                    *([short(exact["impacts"]) if exact["digits"] else DASH] if known else []),
                    spread(row, "fraction", 100.0), spread(exact, "fraction", 100.0),
                ]
            )  # fmt: skip
    other = {row["other contact"]["contact"] for found in numbers.values() for row in found["runs"].values()}
    return h.joined(
        h.paragraph(
            "Impacts to T by the paper's rule at the paper's step, of the exact motion by events. ± is one standard "
            f"deviation over runs whose initial data differ by {written(PERTURBATION)} of the motion: counts inside it "
            "are the same. The paper gives counts for Tables 10 to 13 only. They fit none of the spans its CPU times "
            "allow. "
            + (
                "True is the one count of the motion that starts exactly at rest, from the multiprecision solution."
                if known
                else "The true count of the motion that starts exactly at rest is not known without multiprecision "
                "solutions (--references)."
            )
        ),
        h.table(
            [
                "table, scheme", "paper", "ensemble", f"{', '.join(sorted(other))} contact, one run", "exact ensemble",
                *(["true"] if known else []), "contact, %", "exact contact, %",
            ],
            rows,
            "Impacts and share of time in contact",
        ),
    )  # fmt: skip


def _same(equation: str, scheme: Scheme, form: str) -> bool:
    from .table import equation_of

    return equation_of(scheme, form) == equation


def cpu(rows: Sequence[Mapping[str, Any]]) -> h.Html:
    """The section of costs: the paper's seconds beside times a step here."""
    parts = [
        h.paragraph(
            "The paper's seconds (Pentium III, 800 MHz, Matlab) and time a step here, as ratios within a table. "
            "Here all schemes are marched by one compiled kernel in modal coordinates, so that the number of stages "
            "costs little; the paper solved a banded system per stage."
        )
    ]
    for tables in CPU_TABLES:
        own = [row for row in rows if row["table"] in tables]
        if own:
            cells = [
                [
                    f"{row['table']} {row['equation']}", f"{row['paper_seconds']:g}", f"{row['paper_ratio']:.2f}",
                    short(row["ns_per_step"], 3), "–" if row["ratio"] is None else f"{row['ratio']:.2f}",
                ]
                for row in own
            ]  # fmt: skip
            unit = own[0]["unit"]
            headings = ["table, scheme", "paper, s", f"over {unit}", "here, ns a step", f"over {unit}, here"]
            parts.append(h.table(headings, cells, f"CPU time, Tables {tables[0]} to {tables[-1]}"))
    return h.joined(*parts)


def spectra(numbers: Mapping[int, Numbers]) -> h.Html:
    """The section of spectra: lines of every table and motion."""
    evidence = Evidence(dict(numbers), [], Reading())
    rows = []
    for table, found in numbers.items():
        for motion in [*found["runs"], *found["exact"]]:
            row = evidence.row(table, motion)
            if not row["ensemble"]:
                continue
            shares = [spread(row, x, 100.0) for x in ("band", "off_multiples", "aperiodicity", "rate_aperiodicity")]
            rows.append(
                [f"{table} {evidence.name(table, motion)}", named(lines(evidence, table, motion)),
                 spread(row, "even_over_odd"), *shares]
            )  # fmt: skip
    return h.joined(
        h.paragraph(
            "Lines: the multiples of the drive at which all members have the same phase and amplitude but for their "
            f"scatter, of {100 * EXCITED:g} % of the largest or more (a stands for w in Tables 15 and 16). Even over "
            "odd: geometric means of the multiples from 2a to 15a. Band: the share of the frequencies to 15a with more "
            "than a hundredth of the largest amplitude. Beside: the share of squared amplitudes that is on no "
            "multiple. Change: the rms change of tip and velocity over a drive period, 0 for a periodic motion, about "
            "100 where nothing is left."
        ),
        h.table(
            [
                "table, motion",
                "lines, 2a to 9a",
                "even over odd",
                "band, %",
                "beside, %",
                "change, %",
                "of velocity, %",
            ],
            rows,
            "Spectra of the ensembles, mean and standard deviation",
            text=(0, 1),
        ),
    )


def misprints(rows: Sequence[Mapping[str, str]]) -> h.Html:
    """The table of misprints and of their measured effect."""
    cells = [[row["where"], row["printed"], row["right"], typeset(row["effect"])] for row in rows]
    return h.table(
        ["where", "printed", "right", "effect, measured"], cells, "Misprints and their effect", text=(0, 1, 2, 3),
        cards=True,
    )  # fmt: skip
