"""What stands at the end of every command's help: a few commands that work as they are."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "advise": ("stiffbeam advise table10 --want tip=1e-3,impacts=0.05", "stiffbeam advise my-beam.toml --t-end 0.2"),
    "animate": (
        "stiffbeam animate table10 --t-end 0.3",
        "stiffbeam animate table10 --schemes bdf2,sdirk --out film.mp4",
    ),
    "cases": ("stiffbeam cases", "stiffbeam cases --show table10 > my-beam.toml", "stiffbeam cases --json -"),
    "compare": (
        "stiffbeam compare table10",
        "stiffbeam compare my-beam.toml --dt 1e-5 --references exact",
        "stiffbeam compare table10 --schemes 'bdf2,hht(alpha=-0.2)' --json records.json",
    ),
    "doctor": ("stiffbeam doctor", "stiffbeam doctor --json -"),
    "reference": (
        "stiffbeam reference table10 --t-end 0.5",
        "stiffbeam reference table10 --method multiprecision --t-end 1 --out exact.nc",
        "stiffbeam reference --check reference",
    ),
    "reproduce": (
        "stiffbeam reproduce table 10",
        "stiffbeam reproduce figure 17 --out figures",
        "stiffbeam reproduce all",
    ),
    "score": (
        "stiffbeam score bdf2,cvode --problem bilinear-gap",
        "stiffbeam score --trajectory run.csv --problem bouncing-ball",
        "stiffbeam score --list",
    ),
    "studies": ("stiffbeam studies table10", "stiffbeam studies my-beam.toml --smoke"),
    "amplification": ("stiffbeam amplification", "stiffbeam amplification --schemes bdf2,bathe"),
    "modes": ("stiffbeam modes table10", "stiffbeam modes my-beam.toml --schemes bdf2"),
    "energy": ("stiffbeam energy table10", "stiffbeam energy my-beam.toml --t-end 0.1"),
    "converge": ("stiffbeam converge table10", "stiffbeam converge my-beam.toml --schemes 'hht(alpha=-0.1),bathe'"),
    "space": ("stiffbeam space table10", "stiffbeam space my-beam.toml --cells 10,20,40"),
    "rigid": ("stiffbeam rigid table10", "stiffbeam rigid my-beam.toml --impacts 2"),
    "rigid-bar": ("stiffbeam rigid-bar --smoke",),
    "rigid-beam": ("stiffbeam rigid-beam table10", "stiffbeam rigid-beam my-beam.toml --kappas 1e6,1e8"),
    "first-impact": ("stiffbeam first-impact table10", "stiffbeam first-impact my-beam.toml --cells 10,20,40"),
    "restitution": ("stiffbeam restitution",),
    "errata": ("stiffbeam errata table10",),
    "impacts": ("stiffbeam impacts table10", "stiffbeam impacts my-beam.toml --schemes bdf2"),
    "contact-duration": ("stiffbeam contact-duration table10",),
    "precision": ("stiffbeam precision table10",),
    "ensemble": (
        "stiffbeam ensemble table10 --members 50",
        "stiffbeam ensemble table10 --schemes trapezoidal --contact conserving",
    ),
    "chaos": ("stiffbeam chaos table10",),
    "sweep": (
        "stiffbeam sweep table10 --parameter frequency --values 8:14:400",
        "stiffbeam sweep my-beam.toml --parameter amplitude --values 5e-4:2e-3:100",
    ),
}
STATUS = "Exit status: 0 done; 1 a run failed, or nothing was found or agrees; 2 bad input; 130 interrupted, repeat it."


def epilog(name: str) -> str:
    """Examples and exit status, each a paragraph."""
    return "\n\n".join(["Examples:", *(f"  {line}" for line in EXAMPLES.get(name, ())), STATUS])
