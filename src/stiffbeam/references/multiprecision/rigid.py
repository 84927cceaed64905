"""The solution with rigid stops in many digits, as a Reference. It shares no code with the float64 solution."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import flint
import numpy as np
from flint import arb, arb_mat

from ...basics.arrays import Array
from ...basics.resources import clock
from ...model.system import System
from ...model.time_functions import evaluate, offset_rate
from ...trajectory.records import ContactRecord, Impacts, Ledger, as_it_starts, last_before
from ...trajectory.trajectory import Reference, SolverFailure, Work
from ..registry import Request, output_times, provenance_of
from ..rigid_stops import require_rigid, require_smooth
from .impacting import Impact, March, Motion
from .linear_flow import Undecided
from .rational import carried

FIRST = 40  # digits to begin with
LAST = 20_000
GUARD = 100  # bits below the digits: two doubles' worth for the outputs
SPARE = 64  # and for the sums
TRIES = 3  # with twice the digits, where these do not tell whether a stop is touched
AGREEMENT = 1e-12  # of max |u| and of the time
GAUSS = np.polynomial.legendre.leggauss(16)  # of a stretch of 4 radians at most: to rounding


def solve_rigid(request: Request) -> Reference:
    """The solution from impact to impact with ``digits`` decimal digits, and again with more.

    Takes what the exact solution takes of rigid stops with restitution in [0, 1]: any damping, several contacts, moving
    stops, time functions made of Harmonic, Constant and Sampled. "auto" begins with FIRST digits, and goes on until
    two runs agree to t_end, in impacts and outputs; a fixed number gives the horizon to which both agree. Impacts that
    accumulate are followed until their series leaves out less than the digits hold, at most
    provenance["chatter_left_out"] of the time at which they end. The horizon ends before blows at one
    time of which the order decides what follows, and at t = 0 where rounding of the start decides it.
    Raises InputError as ``require_rigid`` and ``require_smooth``, for more than 200 000 impacts, and where outputs are
    not in order; SolverFailure where a stop is touched so closely that even four times the digits do not tell whether
    it is hit.
    """
    system, t_end, digits = request.system, request.t_end, request.digits
    require_rigid(system, t_end)
    require_smooth(system)
    t = output_times(request.t_eval, t_end)
    # Solve with more and more digits until two runs agree.
    begun, wanted, tries = clock(), FIRST if digits == "auto" else int(digits), TRIES
    previous: tuple[Solved, Reference] | None = None
    while True:
        if wanted > LAST:
            raise SolverFailure("multiprecision", t_end, f"{wanted} digits are not enough", "shorten t_end")
        try:
            solved = Solved.of(system, t_end, wanted)
        except Undecided as touched:
            tries -= 1
            if digits != "auto" or not tries or previous is not None:
                reason = f"a stop is touched: {wanted} digits do not tell whether it is hit"
                remedy = "move the stop or the start a little, or let the exact solution decide by rounding"
                raise SolverFailure("multiprecision", touched.args[0], reason, remedy) from None
            wanted *= 2
            continue
        run = solved.reference(system, t, t_end, begun)
        if previous is not None:
            before, its_run = previous
            horizon = min(_agreement(before, solved, t_end), _outputs(its_run, run))
            # A fixed number of digits is confirmed once. The horizon ends before the first tie.
            if horizon >= t_end or digits != "auto":
                horizon = min(horizon, float(np.max(t[t < solved.motion.tie], initial=0.0)))
                notes = {
                    "digits_confirmed_with": before.digits,
                    "horizon": horizon,
                    "horizon_against": f"itself with {before.digits} digits",
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u| at the output times, the same impacts",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
            # Digits in proportion to the time, but at most ten times as many.
            wanted = max(wanted, math.ceil(wanted * t_end / max(horizon, 0.1 * t_end)))
        previous, wanted = (solved, run), math.ceil(1.25 * wanted) + 15


@dataclass(frozen=True, eq=False)
class Solved:
    """A motion and the digits it was carried with."""

    motion: Motion
    digits: int
    bits: int
    times: Array  # of its stretches

    @classmethod
    def of(cls, system: System, t_end: float, digits: int) -> Solved:
        """Solve; raises Undecided where more digits may help."""
        bits = math.ceil(digits * math.log2(10.0)) + GUARD
        with carried(bits + SPARE):
            motion = March(system, t_end, bits).run()
        return cls(motion, digits, bits, np.array([float(x.t) for x in motion.stretches]))

    def at(self, t: Array, forms: list[Any]) -> Array:
        """Forms (k, 1, N) of z at times in any order, (times, k), rounded once; 0 where all of it is rounding, as of a
        body at rest on its stop."""
        values_at = np.empty((len(t), len(forms)))
        piece = np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)
        with carried(self.bits + SPARE):
            # One series for all times in a segment.
            rows = arb_mat([form.entries() for form in forms]).transpose()
            weights = np.abs(np.array(rows.tolist(), float))
            for k in np.unique(piece).tolist():
                here, stretch = np.flatnonzero(piece == k), self.motion.stretches[k]
                series = self.motion.flow.series(stretch.regime, stretch.z, stretch.length)
                coefficients = (series.coefficients * rows).mid()
                rounding = self.motion.flow.terms(stretch.z, stretch.length) @ weights * 2.0**-self.bits
                for i, when in zip(here.tolist(), t[here].tolist(), strict=True):
                    x = (arb(when) - stretch.t) / stretch.length
                    values = arb_mat([series.powers(x)]) * coefficients
                    values_at[i] = [float(y.mid()) for y in values.entries()]
                values_at[here] = np.where(np.abs(values_at[here]) <= rounding, 0.0, values_at[here])
        return values_at

    def observed(self, t: Array, channel: int) -> tuple[Array, Array]:
        """Position and velocity of a channel."""
        flow = self.motion.flow
        u, v = self.at(np.asarray(t, float), [flow.forms[channel], flow.rates[channel]]).T
        return u, v

    def states(self, t: Array) -> tuple[Array, Array]:
        """q and q', (k, n)."""
        flow = self.motion.flow
        units = [arb_mat([[arb(int(i == j)) for j in range(flow.N)]]) for i in range(2 * flow.n)]
        both = self.at(np.asarray(t, float), units)
        return both[:, : flow.n], both[:, flow.n :]

    def reactions(self, t: Array) -> Array:
        """(k, m), of held contacts only."""
        reactions = np.zeros((len(t), len(self.motion.held)))
        piece = np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)
        for regime in {id(x.regime): x.regime for x in self.motion.stretches if x.regime.held}.values():
            here = np.flatnonzero([self.motion.stretches[k].regime is regime for k in piece.tolist()])
            if len(here):
                reactions[here[:, None], list(regime.held)] = self.at(t[here], regime.reactions)
        return reactions

    def impacts(self, contact: int) -> Impacts:
        """Impacts of one contact, in order. If it is still held at the end, that end and the impulse are not known."""
        mine = [x for x in self.motion.impacts if x.contact == contact]
        ends = [math.nan if x.end is None else float(x.end) for x in mine]
        impulses = [math.nan if x.end is None else float(x.impulse) for x in mine]
        times, sides = [float(x.time) for x in mine], [x.side for x in mine]
        return Impacts.at(times, sides, "event", ends=ends, impulses=impulses)

    def reference(self, system: System, t: Array, t_end: float, begun: float) -> Reference:
        """The Reference with outputs at ``t``."""
        R, motion = self.reactions(t), self.motion
        contacts = []
        for c, contact in enumerate(system.contacts):
            impacts = self.impacts(c)
            # The peak is 0 only where nothing touched: a blow has no finite force.
            peak = math.nan if impacts.count or motion.held[c] else 0.0
            seen = as_it_starts(system, c, t, *self.observed(t, c))
            share = motion.held[c] / t_end
            contacts.append(ContactRecord(contact.stops, *seen, R[:, c], impacts, share, peak, motion.pressed[c]))
        tip, velocity = as_it_starts(system, system.tip_channel, t, *self.observed(t, system.tip_channel))
        notes = {
            "digits": self.digits,
            "parameters": "doubles; exact: " + ("; ".join(system.exact_parameters) or "none"),
            "python-flint": flint.__version__,
            "chatter_left_out": motion.left_out,
        }
        seconds = clock() - begun
        return Reference(
            t=t,
            tip=tip,
            tip_velocity=velocity,
            contacts=tuple(contacts),
            work=Work(seconds=seconds, march_seconds=seconds, counters={"stretches": len(self.times)}),
            provenance=provenance_of(system, "multiprecision", t_end, notes),
            system=system,
            evaluate=self.observed,
            state_at=self.states,
            ledger=partial(self.ledger, system, t),
            solution=self,
        )

    def ledger(self, system: System, t: Array) -> Ledger:
        """Input and viscous loss by quadrature in every stretch, what impacts take from their impulses."""
        # Quadrature from output to output and from segment to segment, in each of which the densities are smooth.
        edges = np.unique(np.concatenate([t, self.times[(self.times > t[0]) & (self.times < t[-1])]]))
        points, weights = GAUSS
        half = 0.5 * np.diff(edges)
        nodes = ((edges[:-1] + half)[:, None] + half[:, None] * points).ravel()
        _, v = self.states(nodes)
        # Power of the loads and of the moving stops, and viscous loss.
        power, R = np.zeros(len(nodes)), self.reactions(nodes)
        for p, f in system.loads:
            power += evaluate(f, nodes) * (v @ p)
        for c, contact in enumerate(system.contacts):
            power -= R[:, c] * offset_rate(contact.offset, nodes)
        drag = np.sum(v * (v @ system.damping), axis=1)
        given, lost = (
            np.concatenate([[0.0], np.cumsum(half * (density.reshape(-1, len(points)) @ weights))])
            for density in (power, drag)
        )
        at = np.searchsorted(edges, t)
        # What the blows up to each output have taken, and what the motion of the stops has put in at them.
        when, *impulsive = np.array(self.motion.taken).reshape(-1, 3).T
        so_far = np.searchsorted(when, t, side="right")
        taken, moved = (np.concatenate([[0.0], np.cumsum(x)])[so_far] for x in impulsive)
        energies = system.energies(t, *self.states(t))
        energy, given, lost = np.sum(energies, axis=0), given[at] + moved, lost[at]
        loss = energy[0] - energy + given - given[0] - (lost - lost[0]) - (taken - taken[0])
        return Ledger(t, *energies, given, lost, loss, loss, np.zeros_like(loss), taken)


def _agreement(a: Solved, b: Solved, t_end: float) -> float:
    """The time to which the impacts of two solutions agree."""
    mine, theirs = _distinct(a.motion.impacts), _distinct(b.motion.impacts)
    for x, y in zip(mine, theirs, strict=False):
        same = (x.contact, x.side) == (y.contact, y.side)
        if not same or not abs(x.time - y.time) <= AGREEMENT * y.time:
            return min(float(x.time), float(y.time))
    n = min(len(mine), len(theirs))
    return min([t_end, *(float(x.time) for x in (*mine[n:], *theirs[n:]))])


def _distinct(impacts: list[Impact]) -> list[Impact]:
    """Impacts without those within AGREEMENT after another of their contact. Two contacts that hit each other in turns
    until they rest do so more often with more digits."""
    distinct: list[Impact] = []
    before: dict[int, Any] = {}
    for x in impacts:
        if x.contact not in before or x.time - before[x.contact] > AGREEMENT * x.time:
            distinct.append(x)
        before[x.contact] = x.time
    return distinct


def _outputs(a: Reference, b: Reference) -> float:
    """The time to which the outputs of two solutions agree."""
    scale = float(np.max(np.abs(b.tip)))
    return last_before(b.t, ~(np.abs(a.tip - b.tip) <= AGREEMENT * scale), float(b.provenance["t_end"]))
