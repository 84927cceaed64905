"""Runs as flat tables: one line per time, impact, member; and as files that spreadsheets and MATLAB read."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..basics.arrays import Array
from ..basics.storage import write_whole

if TYPE_CHECKING:
    import pandas

    from .impacts import ContactRecord


def columns_of(t: Array, tip: Array, tip_velocity: Array, contacts: tuple[ContactRecord, ...]) -> dict[str, Array]:
    """t, tip, tip_velocity, and position, velocity and force of every contact, contact0_force and so on."""
    found = {"t": t, "tip": tip, "tip_velocity": tip_velocity}
    for i, contact in enumerate(contacts):
        found |= {f"contact{i}_{name}": getattr(contact, name) for name in ("position", "velocity", "force")}
    return found


def table(columns: dict[str, Any], attributes: dict[str, Any] | None = None) -> pandas.DataFrame:
    """A DataFrame of the columns; what belongs to all of it stands in ``attrs``."""
    import pandas

    frame = pandas.DataFrame(columns)
    frame.attrs.update(attributes or {})
    return frame


def impact_columns(contacts: tuple[ContactRecord, ...]) -> dict[str, list[Any]]:
    """contact, time, end, stop, peak, impulse and open_at_start of every row, contact by contact."""
    names = ("time", "end", "stop", "peak", "impulse", "open_at_start")
    found: dict[str, list[Any]] = {name: [] for name in ("contact", *names)}
    for i, contact in enumerate(contacts):
        x, flags = contact.impacts.listed()
        found["contact"] += [i] * x.count
        for name, values in zip(names, (x.times, x.ends, x.stops, x.peaks, x.impulses, flags), strict=True):
            found[name] += values.tolist()
    return found


def write_csv(frame: pandas.DataFrame, file: Path) -> Path:
    """One line per time with a line of names first; numbers to all their digits."""
    return write_whole(file, frame.to_csv(index=False))


def write_mat(columns: dict[str, Any], impacts: dict[str, list[Any]], notes: dict[str, Any], file: Path) -> Path:
    """A MATLAB 5 file: the columns by name, a struct ``impacts``, and ``provenance`` as JSON."""
    import numpy as np
    from scipy.io import savemat

    content: dict[str, Any] = {name: np.asarray(values)[:, None] for name, values in columns.items()}
    content["impacts"] = {name: np.asarray(values, float)[:, None] for name, values in impacts.items()}
    content["provenance"] = json.dumps(notes)
    made = BytesIO()
    savemat(made, content, appendmat=False)
    return write_whole(file, made.getvalue())
