"""The journal: what a study has finished, so that an interrupted one goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..cases import Case
from ..semidiscretisation import semidiscretise
from .study import Point, Row


class Journal:
    """One line per finished point, appended and flushed; a line cut short by a kill is ignored.

    The file's name holds a hash of study, physics, grid, step, span and the package's source: a journal
    of anything else is never read, and never overwritten.
    """

    def __init__(self, folder: Path | None, study: str, case: Case) -> None:
        self.file = None if folder is None else folder / f"{study}-{_digest(study, case)}.jsonl"
        self.finished: dict[str, list[Row]] = {}
        if self.file is None:
            return
        self.file.parent.mkdir(parents=True, exist_ok=True)
        if self.file.is_file():
            text = self.file.read_bytes()
            whole = text[: text.rfind(b"\n") + 1]
            for line in whole.splitlines():
                try:
                    entry = json.loads(line)
                    point, rows = entry["point"], entry["rows"]
                except (ValueError, KeyError, TypeError):
                    continue  # a damaged line: its point is evaluated again
                if not all("failed" in row for row in rows):  # what failed may work now
                    self.finished[_key(point)] = rows
            if len(whole) < len(text):
                os.truncate(self.file, len(whole))  # never rewritten: a kill here must not lose the rest

    def rows(self, point: Point) -> list[Row] | None:
        """The rows of a finished point, None where it is still to be evaluated."""
        return self.finished.get(_key(point))

    def keep(self, point: Point, rows: list[Row]) -> list[Row]:
        """Note a finished point; the rows come back as a later run will read them."""
        line = json.dumps({"point": point, "rows": rows}, default=_number)
        if self.file is not None:
            with self.file.open("a", encoding="utf-8") as stream:
                stream.write(line + "\n")
        self.finished[_key(point)] = json.loads(line)["rows"]
        return self.finished[_key(point)]


def _key(point: Point) -> str:
    return json.dumps(point, sort_keys=True, default=_number)


def _number(value: Any) -> Any:
    """A NumPy scalar as a plain number."""
    return value.item()


def _digest(study: str, case: Case) -> str:
    system = semidiscretise(case.problem, case.cells, "displacement")
    runs = [f"{scheme}@{form}" for scheme, form in case.runs]
    content = f"{study} {system.fingerprint} {case.cells} {case.dt!r} {case.t_end!r} {runs} {version('stiffbeam')}"
    return hashlib.sha256(f"{content} {source_hash()}".encode()).hexdigest()[:12]


@cache
def source_hash() -> str:
    """A hash of the package's own files: results of an edited package are not those of this one."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()
