"""The search for the step that a wanted error needs: all schemes together, from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from ..basics.progress import Show
from ..basics.validation import InputError
from ..model.drive import Drive
from ..model.scales import scales
from ..model.system import System
from ..schemes import Scheme
from ..trajectory.trajectory import Diverged
from .advice_criteria import COLUMNS, Criterion, Motion
from .common import label_of

if TYPE_CHECKING:
    from .engine.journal import Journal

Tell = Callable[[str], None]
BETWEEN = 5  # steps of one motion that are tried between a step and its half; means say themselves how sure they are
PER_PERIOD = 8  # steps of the coarsest run in the shorter of the longest time scale and the drive's period
QUANTITIES = ("tip", *(name for name, _ in COLUMNS))


@dataclass(frozen=True)
class Probe:
    """One run that was tried: its errors by quantity, infinite where it broke off. work: linear solves."""

    scheme: Scheme
    contact: str
    dt: float
    steps: int
    work: int
    seconds: float
    errors: dict[str, float]

    @property
    def label(self) -> str:
        """The scheme, and the contact treatment where it is not the implicit one."""
        return f"{self.scheme}" + (f", {self.contact} contact" if self.contact != "implicit" else "")

    def meets(self, want: Mapping[str, float]) -> bool:
        """Whether every error is at most the one wanted."""
        return all(self.errors[name] <= tolerance for name, tolerance in want.items())


def search(
    system: System, t_end: float, candidates: list[tuple[Scheme, str]], criterion: Criterion, want: dict[str, float],
    most: int, show: Show, tell: Tell, journal: Journal | None,
) -> tuple[list[Probe], Probe | None]:  # fmt: skip
    """All candidates together from coarse to fine, each until two steps in a row meet the want and so do those between
    them, or it costs more than the best that does; what is known after every refinement is told."""

    def run(scheme: Scheme, contact: str, steps: int) -> Probe | None:
        return _probe(system, t_end, scheme, contact, steps, criterion, journal)

    tried: list[Probe] = []
    best: Probe | None = None
    steps = min(most, max(4, int(np.ceil(PER_PERIOD * t_end / _period(system, t_end)))))
    alive: list[tuple[Scheme, str, Probe | None]] = [(scheme, contact, None) for scheme, contact in candidates]
    while alive and steps <= most:
        left, here = [], []
        for done, (scheme, contact, before) in enumerate(alive):
            show(f"advise: runs of {steps} steps", done, len(alive))
            good = before if before is not None and before.meets(want) else None
            if best is not None and (good.work if good else steps * len(scheme.nodes)) >= best.work:
                continue
            probe = run(scheme, contact, steps)
            if probe is None:
                continue  # what this scheme or these stops do not take
            here.append(probe)
            if good and probe.meets(want):
                others = _between(good, partial(run, scheme, contact), want) if isinstance(criterion, Motion) else []
                tried += others
                if all(p.meets(want) for p in others):
                    best = good
                    tell(f"cheapest so far: {best.label}, {best.steps} steps, {best.work} linear solves")
                    continue
            left.append((scheme, contact, probe))
        if here:
            least = {name: min(here, key=lambda p, name=name: p.errors[name]) for name in want}
            words = ", ".join(f"{name} {p.errors[name]:.2g} ({p.label})" for name, p in least.items())
            tell(f"{steps} steps: {words}")
        tried, alive, steps = tried + here, left, 2 * steps
    return tried, best


def _between(coarse: Probe, probe: Callable[[int], Probe | None], want: Mapping[str, float]) -> list[Probe]:
    """Runs of steps between those of ``coarse`` and their half, as far as they meet the want."""
    found: list[Probe] = []
    for k in range(1, BETWEEN + 1):
        one = probe(round(coarse.steps * 2.0 ** (k / (BETWEEN + 1))))
        if one is not None:
            found.append(one)
            if not one.meets(want):
                break
    return found


def _period(system: System, t_end: float) -> float:
    """The shorter of the longest time scale and the drives' periods."""
    return min(scales(system, t_end).period, *(2.0 * np.pi / rate for rate in Drive.of(system).frequencies), t_end)


def _probe(
    system: System, t_end: float, scheme: Scheme, contact: str, steps: int, criterion: Criterion,
    journal: Journal | None,
) -> Probe | None:  # fmt: skip
    """The run of these steps, read where the journal has it; None where it is refused."""
    dt, work = t_end / steps, steps * len(scheme.nodes)
    point = {"system": system.fingerprint, "t_end": t_end, "contact": contact, "steps": steps, **criterion.point}
    if journal is not None:
        point["scheme"] = label_of(scheme)  # a scheme of one's own need not have one
        if rows := journal.rows(point):
            return Probe(scheme, contact, dt, steps, work, **rows[0])
    try:
        errors, seconds = criterion.errors(system, scheme, contact, dt, t_end)
    except Diverged:
        errors, seconds = dict.fromkeys(map(str, QUANTITIES), np.inf), 0.0
    except InputError as error:
        if error.field != "dt":  # else a step at which it is refused
            return None
        errors, seconds = dict.fromkeys(map(str, QUANTITIES), np.inf), 0.0
    if journal is not None:
        journal.keep(point, [{"seconds": seconds, "errors": errors}])
    return Probe(scheme, contact, dt, steps, work, seconds, errors)


def cheapest(tried: list[Probe], want: dict[str, float]) -> Probe | None:
    """The cheapest run that meets the want with all finer ones, one at least; else a coarse run meets it by chance."""
    good: list[Probe] = []
    for label in dict.fromkeys(probe.label for probe in tried):
        finest_first = sorted((p for p in tried if p.label == label), key=lambda p: -p.steps)
        good += list(takewhile(lambda p: p.meets(want), finest_first))[1:]
    return min(good, key=lambda p: p.work, default=None)


def unreached(tried: list[Probe], want: dict[str, float], most: int) -> dict[str, str]:
    """Of the wanted quantities those that are met from no step on; where there is none, the one that costs most."""
    alone = {name: cheapest(tried, {name: x}) for name, x in want.items()}
    found = {}
    for name in [name for name, probe in alone.items() if probe is None]:
        best = min(tried, key=lambda p, name=name: p.errors[name])
        runs = f"{'from no step on all' if best.meets({name: want[name]}) else 'none'} of {len(tried)} runs of up to "
        found[name] = f"{runs}{most} steps; the best has {best.errors[name]:.2g}, {best.label} at dt = {best.dt:.3g}"
    if found:
        return found
    name = max(alone, key=lambda n: alone[n].work)  # type: ignore[union-attr]
    probe = alone[name]
    assert probe is not None
    return {name: f"not together with the rest; alone with {probe.label} at dt = {probe.dt:.3g}"}
