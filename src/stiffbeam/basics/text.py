"""Results as text: messages, plain values for JSON, paths to the parts of an object, and pictures by name."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

LONGEST = 300  # letters of a message


class _Short(reprlib.Repr):
    def repr_instance(self, x: Any, level: int) -> str:
        try:
            # NumPy's numbers as plain ones: 1.0, not np.float64(1.0).
            return repr(x.item() if isinstance(x, np.generic) else x)
        except Exception:  # of an integer of thousands of digits, or whatever the objects of others raise
            return f"a {type(x).__name__}"

    repr_int = repr_instance


_SHORT = _Short()
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = 12
_SHORT.maxstring = LONGEST


def shown(value: Any) -> str:
    """The shortened repr of ``value``; also works for a value whose repr fails."""
    return printable(_SHORT.repr(value))


def printable(text: str) -> str:
    """``text`` on one line. Terminal control characters are written as their escapes, "\x1b"."""
    # ascii() writes what cannot be printed as an escape, in quotes that are cut off.
    return "".join(x if x.isprintable() else ascii(x)[1:-1] for x in " ".join(text.split()))


def several(count: int, noun: str) -> str:
    """A number of things: "1 contact", "2 contacts"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def sentence(parts: Sequence[str], between: Sequence[str]) -> str:
    """parts[0] between[0] parts[1] ...: one line, its longest parts cut in the middle to make LONGEST letters."""
    parts = [printable(part) for part in parts]
    left = LONGEST - sum(map(len, between))
    # Shortest first: what a part does not use is left to the longer ones.
    for taken, length in enumerate(sorted(map(len, parts))):
        share = left // (len(parts) - taken)
        if length > share:  # this one and all that are longer
            parts = [cut(part, share) for part in parts]
            break
        left -= length
    return "".join(x for pair in zip(parts, [*between, ""], strict=True) for x in pair)


def cut(text: str, most: int) -> str:
    """``text``, its middle left out where it is longer than ``most``."""
    tail = (most - 3) // 2
    return text if len(text) <= most else f"{text[: most - 3 - tail]}...{text[len(text) - tail :]}"


def plain(value: Any) -> Any:
    """``value`` without NumPy's types; JSON has no NaN and no infinity, None stands for them."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def walk(thing: Any, *keys: Any, leaves: tuple[type, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Everything in dataclasses, tuples and lists but not in ``leaves``, with the names and indexes that lead to it."""
    yield keys, thing
    inner: Iterable[tuple[Any, Any]] = ()
    if isinstance(thing, (tuple, list)):
        inner = enumerate(thing)
    elif is_dataclass(thing) and not isinstance(thing, (type, *leaves)):
        inner = ((field.name, getattr(thing, field.name)) for field in fields(thing))
    for key, part in inner:
        yield from walk(part, *keys, key, leaves=leaves)


def path_of(keys: Iterable[Any]) -> str:
    """These names and indexes as Python writes them, "stops[0].upper"."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


DRAW: dict[str, Callable[..., Any]] = {}  # by name: "run", "comparison", "film"
