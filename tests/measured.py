"""What a command's JSON says without what it calls measured: the part that has the same bits in every run."""

from __future__ import annotations

from typing import Any


def settled(record: dict[str, Any]) -> dict[str, Any]:
    """A copy without the fields named under ``measured``, such as "rows.seconds"; each has to be there."""
    record = {name: value for name, value in record.items() if name != "measured"} | {"named": record["measured"]}
    for path in record["named"]:
        record = _without(record, path.split("."))
    return record


def _without(value: Any, names: list[str]) -> Any:
    if isinstance(value, list):
        return [_without(entry, names) for entry in value]
    rest = {name: entry for name, entry in value.items() if name != names[0]}
    inside = {names[0]: _without(value[names[0]], names[1:])} if len(names) > 1 and value[names[0]] else {}
    assert names[0] in value or "failed" in value or "refused" in value, names
    return rest | inside
