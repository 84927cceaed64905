"""The sections of the page that stand in front of and behind the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..cases import paper_cases
from . import html as h
from .claims import FAILS, HOLDS, PARTLY, SCHEME_ONLY
from .costs import CPU_TABLES
from .no_contact import CELLS, DT, STIFFNESS, T_END
from .numbers import PERTURBATION, Numbers, truth_name
from .reading import Reading
from .table_section import DASH, percent, short, spread, written

CITATION = (
    "Y. Dumont, Vibrations of a beam between stops: numerical simulations and comparison of several numerical "
    "schemes, Math. Comput. Simul. 60 (2002) 45–83."
)


def punch_line(numbers: Mapping[int, Numbers], close_up: Path, shares: Path) -> h.Html:
    """What the paper could not see."""
    ten = numbers[10]
    true, runs = ten["true"]["displacement"], ten["runs"]
    written = ", ".join(f"{percent(row['fraction'])} with {_SCHEME[name]}" for name, row in runs.items())
    times = [row["fraction"] / true["fraction"] for row in runs.values()]
    fast = [row["fast"] / true["fast"] for row in runs.values()]
    return h.joined(
        h.paragraph(
            f"In the motion of Table 10 the beam touches a stop for {percent(true['fraction'])} of the time. The "
            f"schemes of the paper, at its step, touch it for {written}. Most of what its figures show as resting on "
            "the stop is numerical dissipation: the schemes take away the fast motion that throws the tip off again.",
            class_="lead",
        ),
        h.figure(
            [
                h.image(
                    close_up,
                    "Tip displacement of Table 10 near the upper stop: the true motion bounces off the stop again "
                    f"and again, the schemes lie on it; they are in contact {min(times):.0f} to {max(times):.0f} "
                    "times as long.",
                )
            ],
            "Table 10 at the upper stop, inside the horizon. Look at the black curve between the stop and 0.09: it "
            "is the solution of the same equations, known to nine digits. "
            + (
                f"The schemes keep {percent(min(fast))} to {percent(max(fast))} of its fast motion (tip velocity "
                "above the second natural frequency)."
            ),
            "one",
        ),
        h.figure(
            [
                h.image(
                    shares,
                    "Share of time in contact, one row per table: the true motion lies between "
                    + f"{percent(_extreme(numbers, min))} and {percent(_extreme(numbers, max))}, the schemes to the "
                    f"right of it.",
                )
            ],
            "Share of the whole time in contact. Look at the distance from the diamonds (true) to the other marks: "
            "that part of the contact is made by the scheme.",
            "one",
        ),
    )


def _extreme(numbers: Mapping[int, Numbers], which) -> float:
    return which(row["fraction"] for found in numbers.values() for row in found["true"].values())


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
        else "corrected. --printed takes (4.13) and σ as printed; what each misprint costs stands below."
    )
    true = (
        "multiprecision solutions of the same semi-discrete equations, to 10⁻⁹ of the motion over the whole span."
        if reading.references
        else "the exact solution in float64. Past the horizon it is one realisation of the motion."
    )
    return h.definition_list(
        [
            ("End times", "never stated. Taken from the ratios of HHT's CPU times and the time axis of Fig. 2c; T "
            "stands with each "
             "table. SDIRK's CPU times and the impact counts fit no such choice, and nothing was tuned to them."),
            ("Initial data", "never stated. At rest: u₀ = 0, v₀ = 0."),
            ("Contact", contact),
            ("Schemes", schemes),
            ("The true motion", true),
            ("Horizon", "motions between stops are chaotic: solutions that differ in the sixteenth digit part after "
            "a few dozen "
             "impacts. The horizon is the time to which float64 can follow the true motion. Errors are measured up "
             "to it; past it "
             "(grey in the figures) a run is one realisation, and only statistics mean something."),
            ("Impact", "a step in contact whose predecessor was not, the paper's rule; true impacts are counted by "
            "events, and by "
             "the same rule at the same step."),
        ],
        "reading",
    )  # fmt: skip


def no_contact(pictures: Sequence[Path], curves: Mapping[str, Mapping[str, float]]) -> h.Html:
    rows = [
        [name, h.typeset(f"{row['error']:.1e}"), h.typeset(f"{row['in_time']:.1e}") if row["in_time"] else "–"]
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
    """The paper's counts, ours, the true ones, and what an ensemble says of all of them."""
    rows = []
    for table, found in numbers.items():
        case = paper_cases()[f"table{table}"]
        published = case.published.get("impacts", {})
        for equation, row in found["runs"].items():
            true = found["true"][row["form"]]
            label = next(f"{s}@{f}" for s, f in case.runs if f == row["form"] and _same(equation, s, f))
            other = row["other contact"]
            rows.append(
                [
                    f"{table} {equation}", short(published.get(label)), short(row["impacts"]), spread(row, "impacts"),
                    "overflow" if "failed" in other else short(other["impacts"]),
                    short(true["impacts"]), short(true["events"]), spread(true, "impacts"),
                    percent(row["fraction"]), percent(true["fraction"]),
                ]
            )  # fmt: skip
    other = {row["other contact"]["contact"] for found in numbers.values() for row in found["runs"].values()}
    return h.joined(
        h.paragraph(
            "Impacts by the paper's rule at the paper's step, over the whole span. ± is one standard deviation over "
            f"runs whose initial data differ by {written(PERTURBATION)} of the motion: counts inside it are the same. "
            "The paper gives counts for Tables 10 to 13 only. They fit none of the spans its CPU times allow."
        ),
        h.table(
            [
                "table, scheme", "paper", "here", "ensemble", f"{', '.join(sorted(other))} contact", "true, "
                "sampled", "true, events",
                "true ensemble", "contact", "true contact",
            ],
            rows,
            "Impacts and share of time in contact",
        ),
    )  # fmt: skip


def _same(equation: str, scheme, form: str) -> bool:
    from .table import equation_of

    return equation_of(scheme, form) == equation


def cpu(rows: Sequence[Mapping[str, Any]]) -> h.Html:
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
    rows = []
    for table, found in numbers.items():
        named = [(equation, row) for equation, row in found["runs"].items()]
        named += [(truth_name(form, row), row) for form, row in found["true"].items()]
        for name, row in named:
            peaks = ", ".join(p["name"] for p in row["peaks"] if p["multiple"] < 9.5) or "none"
            shares = [DASH if row[x] is None else f"{100 * row[x]:.1f}" for x in ("off_multiples", "aperiodicity")]
            rows.append([f"{table} {name}", peaks, f"{row['even_over_odd']:.2f}", *shares])
    return h.joined(
        h.paragraph(
            "A peak stands four times above the median around it, which noise does in one bin of 10⁴; it is named "
            "by the multiple of the drive that it is within half a bin of (a stands for w in Tables 15 and 16). "
            "Even over odd: geometric means of the multiples from 2a to 15a. Beside: the share of squared "
            "amplitudes that is on no multiple. Aperiodicity: the rms change of the tip over a drive period, 0 for "
            "a periodic motion, about 100 where nothing is left."
        ),
        h.table(
            ["table, motion", "peaks to 9a", "even over odd", "beside, %", "aperiodicity, %"],
            rows,
            "Spectra",
            text=(0, 1),
        ),
    )


def claims(judged: Sequence[Mapping[str, str]]) -> h.Html:
    rows = [
        h.element(
            "tr",
            h.element("th", row["section"], scope="row"),
            h.element("td", h.typeset(row["claim"])),
            h.element("td", h.typeset(row["measured"])),
            h.element("td", h.element("span", row["verdict"], class_=f"verdict {_colour(row['verdict'])}")),
        )
        for row in judged
    ]
    counts: dict[str, int] = {}
    for row in judged:
        counts[row["verdict"]] = counts.get(row["verdict"], 0) + 1
    plural = {HOLDS: "hold", FAILS: "do not hold", PARTLY: "hold in part", SCHEME_ONLY: "are true of the scheme only"}
    summary = ", ".join(f"{n} {plural.get(x, x)}" for x, n in sorted(counts.items(), key=lambda item: -item[1]))
    head = h.element(
        "tr", *(h.element("th", x, scope="col") for x in ("section", "the paper says", "measured", "verdict"))
    )
    caption = "Claims and verdicts"
    table = h.element(
        "table", h.element("caption", caption), h.element("thead", head), h.element("tbody", *rows), class_="claims"
    )
    return h.joined(
        h.paragraph(
            f"Of {len(judged)} claims: {summary}. “{SCHEME_ONLY[0].upper()}{SCHEME_ONLY[1:]}” is what the paper's "
            "computations show and the true motion of the same equations does not."
        ),
        h.element("div", table, class_="scroll", tabindex=0, role="region", aria_label=caption),
    )


def _colour(verdict: str) -> str:
    return "holds" if verdict == HOLDS else "fails" if verdict in (FAILS, SCHEME_ONLY) else "partly"


def misprints(rows: Sequence[Mapping[str, str]]) -> h.Html:
    cells = [[row["where"], row["printed"], row["right"], h.typeset(row["effect"])] for row in rows]
    return h.table(
        ["where", "printed", "right", "effect, measured"], cells, "Misprints and their effect", text=(0, 1, 2, 3)
    )
