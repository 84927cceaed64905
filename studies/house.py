"""Size of the package, the files that a call enters, as a debugger would, and the sentences of the pages.

    python studies/house.py                 the table
    python studies/house.py --files HHT     and the files that the calls of this name enter
    python studies/house.py --words         only the words of all pages, of a commit with --words COMMIT

The second of two equal calls is counted, so that nothing is imported, compiled or read from a cache for the first time.
"""

from __future__ import annotations

import argparse
import io
import re
import subprocess
import sys
import tempfile
import threading
import tokenize
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import FrameType

import numpy as np

import stiffbeam as sb

PACKAGE = Path(sb.__file__).parent


def files_entered(call: Callable[[], object]) -> Counter[str]:
    """Calls into every file of the package, in the second of two equal calls."""
    call()
    entered: Counter[str] = Counter()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(str(PACKAGE)):
            entered[str(Path(frame.f_code.co_filename).relative_to(PACKAGE))] += 1

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    return entered


def size() -> tuple[int, int, float]:
    """Lines and files of Python in the package, and the share of lines that are a comment of their own."""
    lines = comments = files = 0
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        files, lines = files + 1, lines + len(text.splitlines())
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            comments += token.type == tokenize.COMMENT and not token.line[: token.start[1]].strip()
    return lines, files, comments / lines


def calls(folder: Path) -> dict[str, Callable[[], object]]:
    """The calls of the table by name, on Table 10."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, case.cells)

    def command() -> None:
        from stiffbeam.cli import app

        chosen = ["--t-end", "0.05", "--schemes", "HHT@displacement", "--references", "exact", "--out", str(folder)]
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            app(["compare", "table10", *chosen], standalone_mode=False)

    return {
        "integrate, HHT": lambda: sb.integrate(system, sb.HHT(alpha=-0.1), 1e-4, 1.0),
        "reference, exact": lambda: sb.reference(system, 0.1),
        "reference, cvode": lambda: sb.reference(system, 0.1, method="cvode"),
        "reference, multiprecision": lambda: sb.reference(system, 0.02, method="multiprecision"),
        "a study on a System": lambda: sb.study("energy", system, t_end=0.05, dt=1e-4),
        "stiffbeam compare": command,
    }


# Methods are not persons, and a concept has one word.
BANNED = r"\b(?:says?|knows?|believes?|tells?|thinks|anew|alike|switch(?:es)?|stretch(?:es)?|flights?|parted|thereby)\b"


def pages(commit: str | None) -> list[str]:
    """Texts of all Markdown pages: those of the working tree, or of a commit."""
    root = PACKAGE.parents[1]

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=root, check=True, capture_output=True, text=True).stdout

    listed = git("ls-files", "*.md") if commit is None else git("ls-tree", "-r", "--name-only", commit)
    names = [name for name in listed.splitlines() if name.endswith(".md")]
    return [git("show", f"{commit}:{name}") if commit else (root / name).read_text(encoding="utf-8") for name in names]


def sentences(text: str) -> list[str]:
    """Sentences of a page, without code, tables, headings and the addresses of links."""
    text = re.sub(r"^```.*?^```$|^(?: {4}|\||#)[^\n]*$", "\n", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)|`", "", re.sub(r"^\s*(?:[-*]|\d+\.) ", "\n", text, flags=re.MULTILINE))
    parts = [part for block in re.split(r"\n\s*\n", text) for part in re.split(r"(?<=[.!?])\s+", block.strip())]
    return [part for part in parts if part]


def words(commit: str | None) -> str:
    """Number of words, length of sentences, semicolons and banned words of all pages."""
    texts = pages(commit)
    said = [sentence for text in texts for sentence in sentences(text)]
    lengths = [len(sentence.split()) for sentence in said]
    prose = " ".join(said)
    banned = len(re.findall(BANNED, prose, re.IGNORECASE))
    return (
        f"pages: {len(texts)}, {sum(lengths)} words, 90 % of sentences have at most {np.percentile(lengths, 90):.0f}, "
        f"{prose.count(';')} semicolons, {banned} banned words, {prose.lower().count('for example')} examples"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", metavar="NAME", help="list the files that the calls with NAME in their names enter")
    parser.add_argument("--words", nargs="?", const="", metavar="COMMIT", help="the words of all pages")
    arguments = parser.parse_args()
    if arguments.words is not None:
        print(words(arguments.words or None))
        return
    wanted = arguments.files
    lines, files, comments = size()
    print(f"package: {lines} lines in {files} files, {100.0 * comments:.1f} % of the lines comments\n")
    print("files entered by")
    with tempfile.TemporaryDirectory() as folder:
        for name, call in calls(Path(folder)).items():
            entered = files_entered(call)
            print(f"    {name:<28} {len(entered):4d}", flush=True)
            if wanted is not None and wanted in name:
                for file, count in sorted(entered.items()):
                    print(f"        {count:8d} calls into {file}")


if __name__ == "__main__":
    main()
