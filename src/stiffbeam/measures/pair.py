"""A run and the reference it is held against: what is asked of both before anything is measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..basics.validation import InputError
from ..trajectory.trajectory import Reference, Trajectory


def run_of(run: Any, reference: Any, asked: str) -> Trajectory:
    """``run``, or its arrays (t, tip) or (t, tip, tip velocity) as a run of the reference's system.

    Raises InputError where they are something else or of two systems, with what differs, and where the reference has
    no horizon.
    """
    if isinstance(run, (tuple, list)) and len(run) in (2, 3) and isinstance(reference, Reference):
        run = Trajectory.from_arrays(*run, system=reference.system)
    if not isinstance(run, Trajectory) or not isinstance(reference, Reference):
        got = f"{type(run).__name__}, {type(reference).__name__}"
        rule = "be given a run, or its arrays (t, tip) or (t, tip, tip velocity), and a reference, in this order"
        raise InputError(asked, got, rule, "reference() makes one")
    require_same_system(run, reference)
    if not np.isfinite(reference.horizon):
        raise InputError("reference.horizon", reference.horizon, "be known", "make it with stiffbeam.reference")
    return run


def require_same_system(run: Trajectory, reference: Reference) -> None:
    """Raise InputError, with what differs, where run and reference are of two systems."""
    if run.fingerprint == reference.fingerprint:
        return
    rule, remedy = f"be of the same system as {run.label}", "solve run.system"
    if run.system is None or reference.system is None:
        rule += ", which is not known of both"
    else:
        differs = run.system.differences(reference.system)
        rule += f"; they differ in: {', '.join(differs)}"
        if differs == ["exact parameters"]:
            remedy += '; 0.1 in Python is a double, in a case file and as "0.1" it is the decimal'
    raise InputError("reference", reference.label, rule, remedy)
