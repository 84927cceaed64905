"""compare: every measure of a run against a reference of the same system."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from ..drive import Drive
from ..modal import undamped_modes
from ..plain import plain
from ..recorder import sampled_impacts
from ..system import System
from ..trajectory import Impacts, Reference, Trajectory
from ..validation import InputError
from .impacts import Matching, match
from .phase import PhaseLag, phase_lag


@dataclass(frozen=True)
class Contacts:
    """Contact statistics of one trajectory over a span: sampled impacts, share of steps in contact,
    peak |sigma| and impulse, the sum of |sigma| dt."""

    impacts: int
    fraction: float
    peak_force: float
    impulse: float


@dataclass(frozen=True)
class Comparison:
    """A run against a reference on [0, window], window = min(t_end, horizon); totals to t_end apart.

    tip_error_rms, tip_error_max: of u_run - u_ref at the run's steps, over max |u_ref|;
    tip_error_matched: the rms over [0, matching.matched_until], before the impacts part.
    energy_lost: the ledger's loss over E_0 + input, all energy the system has had. contacts: of the
    first of ``contact_count`` contacts, for the run and for the reference sampled at the run's steps;
    reference_events: its impacts by events. totals: the same to t_end, one realisation each and not
    comparable with one another.
    """

    label: str
    reference: str
    dt: float
    steps: int
    seconds: float
    ns_per_step: float
    engine: str
    window: float
    t_end: float
    tip_error_rms: float
    tip_error_max: float
    tip_error_matched: float
    phase: PhaseLag
    energy_lost: float
    contacts: Contacts
    reference_contacts: Contacts
    reference_events: int
    matching: Matching
    contact_count: int
    totals: Contacts
    totals_energy_lost: float
    reference_totals: Contacts
    reference_totals_events: int

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings; NaN becomes None, as JSON has none."""
        return plain(asdict(self))

    def __str__(self) -> str:
        from ..report import comparison_text

        return comparison_text([self])

    def _repr_html_(self) -> str:
        from ..report import comparison_html

        return comparison_html([self])


def compare(run: Trajectory, reference: Reference) -> Comparison:
    """All measures of ``run`` against ``reference``, which must be of the same system.

    ``run`` is a scheme's run with every step on output, or another reference at equidistant times.
    Raises InputError where the systems differ, the outputs are thinned or the reference has no horizon.
    """
    if not isinstance(run, Trajectory) or not isinstance(reference, Reference):
        got = f"{type(run).__name__}, {type(reference).__name__}"
        raise InputError("compare", got, "be given a run and a reference, in this order")
    if run.fingerprint != reference.fingerprint:
        raise InputError("reference", reference.label, f"be of the same system as {run.label}", "solve run.system")
    system = run.system or reference.system
    if system is None:
        raise InputError("run", "two loaded files", "leave one trajectory with its system", "integrate again")
    if run.provenance.get("every", 1) != 1:
        raise InputError("every", run.provenance["every"], "be 1 for a comparison", "integrate with every=1")
    if not np.isfinite(reference.horizon):
        raise InputError("reference.horizon", reference.horizon, "be known", "make it with stiffbeam.reference")
    t = run.t
    dt = float(t[1] - t[0])
    if t[0] != 0.0 or np.max(np.abs(np.diff(t) - dt)) > 1e-6 * dt:
        raise InputError("run.t", "other times", "be equidistant from 0 on", "pass t_eval = numpy.arange(n + 1) * dt")
    t_end = min(float(t[-1]), float(reference.provenance["t_end"]))
    window = min(t_end, reference.horizon)
    last = int(np.floor(window / dt * (1 + 1e-12)))
    if last < 2:
        raise InputError("dt", dt, f"leave two steps before the horizon {window:.3g}", "use a smaller dt")
    u_ref, _ = reference.at(t[t <= t_end * (1 + 1e-12)])

    here = slice(0, last + 1)
    scale = float(np.max(np.abs(u_ref[here])))
    error = (run.tip[here] - u_ref[here]) / (scale or 1.0)

    if system.contacts:
        u_contact, v_contact = reference.at(t[: len(u_ref)], contact=0)
        ref_sampled = sampled_impacts(u_contact, v_contact, dt, system.contacts[0].stops)
        own = run.contacts[0]
        sampled = "dt" in run.provenance
        run_sampled = own.impacts if sampled else sampled_impacts(own.position, own.velocity, dt, own.stops)
        position = own.position
    else:
        u_contact, position = u_ref, run.tip
        ref_sampled = run_sampled = Impacts.none("sampled")
    matching = match(run_sampled, ref_sampled, window)
    energy = run.energy
    omega = undamped_modes(system).omega
    omega = omega[omega > 0.0]
    lag = phase_lag(
        t[: len(u_ref)],
        run.tip[: len(u_ref)],
        run.tip_velocity[: len(u_ref)],
        lambda times: u_ref[np.round(times / dt).astype(int)],
        min(window, matching.matched_until),
        max(Drive.of(system).frequencies, default=0.0),
        float(omega[0]) if len(omega) else 0.0,
    )
    return Comparison(
        label=run.label,
        reference=reference.label,
        dt=dt,
        steps=run.work.steps,
        seconds=run.work.seconds,
        ns_per_step=run.work.ns_per_step,
        engine=str(run.provenance.get("engine", "")),
        window=window,
        t_end=t_end,
        tip_error_rms=float(np.sqrt(np.mean(error**2))),
        tip_error_max=float(np.max(np.abs(error))),
        tip_error_matched=float(np.sqrt(np.mean(error[t[here] <= matching.matched_until] ** 2))),
        phase=lag,
        energy_lost=energy.lost_fraction(last),
        contacts=_contacts(system, run_sampled, position[here], dt, window),
        reference_contacts=_contacts(system, ref_sampled, u_contact[here], dt, window),
        reference_events=reference.impacts.until(window).count,
        matching=matching,
        contact_count=len(system.contacts),
        totals=_contacts(system, run_sampled, position[: len(u_ref)], dt, t_end),
        totals_energy_lost=energy.lost_fraction(len(u_ref) - 1),
        reference_totals=_contacts(system, ref_sampled, u_contact, dt, t_end),
        reference_totals_events=reference.impacts.until(t_end).count,
    )


def _contacts(system: System, impacts: Impacts, position: Array, dt: float, end: float) -> Contacts:
    if not system.contacts:
        return Contacts(0, 0.0, 0.0, 0.0)
    stops = system.contacts[0].stops
    force = np.abs(stops.force(position[1:]))
    return Contacts(
        impacts=impacts.until(end).count,
        fraction=float(np.mean(stops.state(position[1:]) != 0)),
        peak_force=float(np.max(force, initial=0.0)),
        impulse=float(np.sum(force) * dt),
    )
