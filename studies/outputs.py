"""Outputs of scripts and of a study with options, as a page that other pages quote.

python studies/outputs.py               # all of them into studies/outputs.md, in ten minutes
python studies/outputs.py hammer        # this one only; the others stay
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

STUDIES = Path(__file__).parent
PAGE = STUDIES / "outputs.md"
HEAD = """# Outputs of the scripts

`python studies/outputs.py` runs these scripts and commands and writes this page. The other pages quote these numbers.
Seconds depend on the machine.
"""
COMMANDS = {
    **{
        name: f"python studies/{name.replace(' ', '_')}.py"
        for name in (
            "steel strip", "hermite model", "hammer", "base motion", "loose supports", "ranking", "stiff stops",
            "scheme flips", "basins",
        )
    },
    "identify": "python studies/identify.py --out .",
    "conserving contact": "stiffbeam ensemble table10 --schemes trapezoidal,exponential-flow --contact conserving",
}  # fmt: skip


def output(command: str) -> str:
    """Return what a command prints, in an empty folder."""
    program, *arguments = command.split()
    words = (
        ["-m", "stiffbeam", *arguments]
        if program == "stiffbeam"
        else [str(STUDIES.parent / arguments[0]), *arguments[1:]]
    )
    environment = os.environ | {"MPLBACKEND": "agg", "COLUMNS": "100"}
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, *words], cwd=folder, env=environment, check=True, stdout=subprocess.PIPE, text=True
        )
        text = done.stdout.replace(folder, ".")
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


def sections(page: str) -> dict[str, str]:
    """Return the outputs on a page by their headings."""
    return dict(re.findall(r"^## ([^\n]*)\n\n`[^\n]*`\n\n```text\n(.*?)\n```$", page, re.DOTALL | re.MULTILINE))


def main() -> None:
    kept = sections(PAGE.read_text(encoding="utf-8")) if PAGE.exists() else {}
    for name in sys.argv[1:] or COMMANDS:
        kept[name] = output(COMMANDS[name])
        print(name, file=sys.stderr)
    parts = [f"## {name}\n\n`{command}`\n\n```text\n{kept[name]}\n```" for name, command in COMMANDS.items()]
    PAGE.write_text("\n\n".join([HEAD.strip(), *parts]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
