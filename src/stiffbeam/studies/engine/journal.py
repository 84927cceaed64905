"""The journal of a study: finished points, so that an interrupted study continues where it stopped."""

from __future__ import annotations

import hashlib
import json
import os
import socket
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

try:
    import fcntl
except ImportError:  # where there is no such lock
    fcntl = None

from ...basics.storage import source_hash
from ...basics.validation import InputError
from ...files.cases import Case
from ...references.registry import REFERENCES
from ...schemes.labels import user_source
from .study import Point, Row
from .table import FEW, Batch


class Journal:
    """Journal file with one line per finished point and its checksum, appended and flushed: its rows, or their columns
    if they are many. Lines that are cut short by a kill or do not match their checksum are ignored. As a context
    manager it is locked: no other process works on it.

    The file's name holds a hash of study, physics, grid, step, span and the package's source: a journal
    of anything else is never read, and never overwritten.
    """

    def __init__(self, folder: Path | None, study: str, case: Case) -> None:
        self.file = None if folder is None else folder / f"{study}-{_digest(study, case)}.jsonl"
        self.finished: dict[str, list[Row] | Batch] = {}
        self._lock: IO[str] | None = None
        if self.file is None:
            return
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.file.touch()
        except OSError as error:
            rule = "lie in a folder that can be written to"
            raise InputError("journal", str(self.file), rule, f"{error.strerror}: name another") from None
        if self.file.is_file():
            text = self.file.read_bytes()
            # A kill may cut the last line short.
            whole = text[: text.rfind(b"\n") + 1]
            for line in whole.splitlines():
                try:
                    entry = json.loads(line)
                    if entry.pop("sum") != _sum(entry):
                        continue
                    point, source = entry["point"], entry.get("source", "")
                    rows = Batch.from_json(entry["table"]) if "table" in entry else entry["rows"]
                except (ValueError, KeyError, TypeError):
                    continue  # a damaged line: its point is evaluated again
                if source != _source(point):
                    continue  # a scheme of one's own that has changed since
                if not all("failed" in row for row in rows):  # what failed may work now
                    self.finished[_key(point)] = rows
            if len(whole) < len(text):
                os.truncate(self.file, len(whole))  # never rewritten: a kill here must not lose the rest

    def rows(self, point: Point) -> list[Row] | None:
        """The rows of a finished point, None if it is not evaluated yet."""
        rows = self.part(point)
        return None if rows is None else list(rows)

    def part(self, point: Point) -> list[Row] | Batch | None:
        """The rows of a finished point as they are kept, None if it is not evaluated yet."""
        return self.finished.get(_key(point))

    def keep(self, point: Point, rows: list[Row]) -> list[Row] | Batch:
        """Record a finished point and return its rows as a later run will read them."""
        entry: dict[str, Any] = {"point": point}
        if source := _source(point):
            entry["source"] = source
        # Through JSON, so that this run returns the rows that a resumed one reads.
        if len(rows) < FEW:
            entry = json.loads(json.dumps(entry | {"rows": rows}, default=_number))
            kept = entry["rows"]
        else:
            kept = Batch.of(rows)
            if self.file is not None:
                entry = json.loads(json.dumps(entry | {"table": kept.to_json()}, default=_number))
        if self.file is not None:
            try:
                with self.file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(entry | {"sum": _sum(entry)}) + "\n")
            except OSError as error:
                remedy = f"{error.strerror}; finished points are kept, run the same command again"
                raise InputError("journal", str(self.file), "be a file that can be written to", remedy) from None
        self.finished[_key(point)] = kept
        return kept

    def __enter__(self) -> Journal:
        """Raises InputError where another process holds the journal."""
        if self.file is not None and fcntl is not None:
            self._lock = self.file.with_suffix(".lock").open("a+")
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                self._lock.seek(0)
                who = self._lock.read().strip() or "another process"
                self._lock.close()
                remedy = "wait for it, or give this one another folder"
                raise InputError("journal", str(self.file), f"be free, and {who} works on it", remedy) from None
            self._lock.truncate(0)
            self._lock.write(f"process {os.getpid()} of {socket.gethostname()}\n")
            self._lock.flush()
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            self._lock.close()  # which frees it, as the end of the process would
            self._lock = None


def _sum(entry: dict[str, Any]) -> str:
    """A checksum of an entry, whatever the order of its names."""
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:16]


def _key(point: Point) -> str:
    return json.dumps(point, sort_keys=True, default=_number)


def _source(point: Point) -> str:
    """Return the source text of the modules of a user's schemes in a point."""
    return "".join(
        user_source(value) for value in point.values() if not isinstance(value, list) and value not in REFERENCES
    )


def _number(value: Any) -> Any:
    """A NumPy scalar as a plain number."""
    return value.item()


def _digest(study: str, case: Case) -> str:
    runs = [f"{scheme}@{form}" for scheme, form in case.runs]
    physics = f"{case.system().fingerprint} {case.grid} {case.dt!r} {case.t_end!r}"
    content = f"{study} {physics} {runs} {version('stiffbeam')}"
    return hashlib.sha256(f"{content} {source_hash()}".encode()).hexdigest()[:12]
