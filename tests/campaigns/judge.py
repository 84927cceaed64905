"""What the package certifies of a random system, held against solvers that share no code with it.

Verdicts: "right"; "refused" (InputError, SolverFailure, Diverged); "wrong"; "not finite"; "exception" (any
other); "short" (right, but trusted to less than a fifth of what float64 can know); "open" (the judge
does not know itself).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from random_systems import case as random_case
from systems import system_of
from witness import Case, Episode, Undecided, solve, wave_value

import stiffbeam as sb
from stiffbeam.references.registry import REFERENCES
from stiffbeam.trajectory.records import Impacts

ADAPTIVE = [method.name for method in REFERENCES.values() if method.kind == "adaptive"]
OUTPUTS = 401
DISPLACEMENT = 1e-3  # of max |u|: what a horizon promises
TOUCH = {"exact": 1e-7, "multiprecision": 1e-7}  # of max |u|: contacts not deeper are neither asked for nor denied
TOUCH_ADAPTIVE = 1e-5
MOST_SECONDS = 5.0  # of work in mpmath, for each of two precisions


@dataclass(frozen=True)
class Verdict:
    """``outcome`` of ``subject``, a method; ``reason``: what is wrong, or why it was refused."""

    outcome: str
    subject: str
    reason: str = ""


class Truth:
    """The motion on two grids in float64, whose difference tells how far it is known, and in mpmath where asked."""

    def __init__(self, case: Case) -> None:
        self.case, self.t = case, np.linspace(0.0, case.t_end, OUTPUTS)
        self.motion, other = solve(case), solve(case, refine=1.37)
        self.tip = self.motion.tip(self.t)
        self.error = np.maximum.accumulate(np.abs(self.tip - other.tip(self.t)))
        self.scale = float(np.max(np.abs(self.tip)))
        # Not known any more where the two have parted by a tenth of what is promised.
        apart = np.flatnonzero(self.error > 0.1 * DISPLACEMENT * self.scale)
        self.known = float(self.t[max(0, apart[0] - 1)]) if len(apart) else case.t_end
        self.episodes = [self.motion.episodes(i) for i in range(len(case.contacts))]
        positions = self.positions
        self.reach = [float(np.max(np.abs(p))) for p in positions]
        # A thousandth of the longest time scale of the run, which of a free motion may be the whole run.
        held = case.frequencies > 1e-9 * np.max(case.frequencies)
        longest = 2.0 * np.pi / float(case.frequencies[0]) if np.all(held) else case.t_end
        self.time_tolerance = 1e-3 * min(longest, case.t_end)

    @cached_property
    def positions(self) -> list[np.ndarray]:
        q = self.motion.states(self.t)[0]
        return [q @ c.row + (0.0 if c.offset is None else wave_value(c.offset, self.t)) for c in self.case.contacts]

    def precise_tip(self, t: np.ndarray) -> np.ndarray | None:
        """By mpmath in two precisions, None where they disagree or it is too much work."""
        if len(self.motion.pieces) > 400:
            return None
        try:
            few, many = (solve(self.case, digits, 1.0, 1000, MOST_SECONDS).tip(t) for digits in (50, 75))
        except Undecided:
            return None
        return many if np.max(np.abs(few - many), initial=0.0) <= 1e-6 * self.scale else None


@lru_cache(maxsize=1)
def truth_of(case: Case) -> Truth:
    return Truth(case)


def judge(case: Case, method: str) -> Verdict:
    """What a reference method of the package makes of the case."""
    try:
        system, truth = system_of(case), truth_of(case)
        return judge_reference(sb.reference(system, case.t_end, method, t_eval=truth.t), truth, method)
    except Undecided as error:
        return Verdict("open", method, str(error))
    except (sb.InputError, sb.SolverFailure, sb.Diverged) as error:
        return Verdict("refused", method, f"{type(error).__name__}: {error}"[:240])
    except Exception as error:
        return Verdict("exception", method, f"{type(error).__name__}: {error}"[:300])


def judge_reference(ref: sb.Reference, truth: Truth, method: str) -> Verdict:
    horizon, end = ref.horizon, truth.case.t_end
    if not np.all(np.isfinite(ref.tip)) or not np.isfinite(horizon):
        return Verdict("not finite", method, f"horizon {horizon}")
    if not 0.0 <= horizon <= end * (1 + 1e-12):
        return Verdict("wrong", method, f"horizon {horizon} outside [0, {end}]")
    inside = (truth.t <= horizon) & (horizon > 0.0)  # a horizon of zero certifies nothing
    error = np.abs(ref.tip - truth.tip)
    promised = DISPLACEMENT * truth.scale
    suspects = np.flatnonzero(inside & (error > promised))
    if len(suspects):
        # Decided in mpmath, where float64 does not know itself or the difference is small.
        k = suspects[:: max(1, len(suspects) // 5)]
        exact = truth.precise_tip(truth.t[k])
        if exact is None and np.all(truth.t[k] > truth.known):
            return Verdict("open", method, f"past {truth.known:g}, where the judge knows")
        if exact is None:
            known = truth.t[k] <= truth.known
            k, exact = k[known], truth.tip[k][known]
        off = np.abs(ref.tip[k] - exact)
        worst = int(np.argmax(off))
        if off[worst] > promised * 1.02:
            return Verdict(
                "wrong", method,
                f"|du| = {off[worst] / max(truth.scale, 1e-300):.3g} max|u| at {truth.t[k][worst] / end:.4g} t_end, "
                f"horizon {horizon / end:.6g} t_end",
            )  # fmt: skip
    for i in range(len(truth.case.contacts)):
        reason = judge_contact(ref, truth, i, method, min(horizon, truth.known))
        if reason:
            return Verdict("wrong", method, f"contact {i}: {reason}")
    reason = judge_energy(ref, truth, method, min(horizon, truth.known)) if method in TOUCH else ""
    if reason:
        return Verdict("wrong", method, reason)
    if horizon < 0.2 * truth.known:
        early = "curve right" if np.all(error[truth.t <= 0.5 * truth.known] <= promised) else "curve wrong"
        return Verdict("short", method, f"horizon {horizon / end:.3g} t_end, known to {truth.known / end:.3g}, {early}")
    return Verdict("right", method)


def judge_contact(ref: sb.Reference, truth: Truth, i: int, method: str, until: float) -> str:
    """Times, stops, count, peaks and impulses of the impacts at contact i before ``until``; "" where right."""
    impacts, episodes = ref.contacts[i].impacts, truth.episodes[i]
    if impacts.kind != "event" or not np.all(np.isfinite(impacts.times)):
        return "" if impacts.kind != "event" else "impact times are not finite"
    tolerance, touch = truth.time_tolerance, TOUCH.get(method, TOUCH_ADAPTIVE) * truth.reach[i]
    contact = truth.case.contacts[i]
    clear = [e for e in episodes if e.depth > touch and e.clear > touch]
    window = (tolerance, until - 1.01 * tolerance)
    begins = {s: np.array([e.begin for e in clear if e.side == s]) for s in (1, -1)}
    for side, times in begins.items():
        own = impacts.times[impacts.stops == side]
        for t in times[(times > window[0]) & (times < window[1])]:
            if not len(own) or np.min(np.abs(own - t)) > 1.01 * tolerance:
                return f"impact at {t:.9g} on stop {side:+d} is missing (tolerance {tolerance:.3g})"
    every = {s: np.array([e.begin for e in episodes if e.side == s]) for s in (1, -1)}
    for t, side in zip(impacts.times, impacts.stops, strict=True):
        if window[0] < t < window[1] and (
            not len(every[int(side)]) or np.min(np.abs(every[int(side)] - t)) > 1.01 * tolerance
        ):
            q = truth.motion.states(np.array([t]))[0] @ contact.row
            u = float(q[0] + (0.0 if contact.offset is None else wave_value(contact.offset, t)))
            stop = contact.upper if side > 0 else contact.lower
            if abs(u - stop) > touch:
                return f"impact at {t:.9g} on stop {int(side):+d} did not happen"
    begin = np.array([e.begin for e in episodes])
    sharp = len(clear) == len(episodes) and not np.any(
        np.abs(np.append(begin, impacts.times) - tolerance) < 0.1 * tolerance
    )
    if sharp:
        count = [int(np.sum((x > window[0]) & (x < window[1]))) for x in (impacts.times, begin)]
        at_edge = np.sum(np.abs(np.append(begin, impacts.times) - window[1]) < 1.1 * tolerance)
        if abs(count[0] - count[1]) > at_edge:
            return f"{count[0]} impacts, true are {count[1]}"
    deviation = np.maximum.accumulate(np.abs(ref.contacts[i].position - truth.positions[i]))
    reason = _peaks(impacts, clear, deviation, truth, i, window, method)
    return reason or (_totals(ref, truth, i, float(deviation[-1])) if until >= truth.case.t_end else "")


def _totals(ref: sb.Reference, truth: Truth, i: int, deviation: float) -> str:
    """Largest force, impulse and time on the stops of the whole motion, where it is known and trusted to its end."""
    record, episodes, end = ref.contacts[i], truth.episodes[i], truth.case.t_end
    kappa, off = truth.case.contacts[i].kappa, 10.0 * deviation + 1e-12 * truth.reach[i]
    time = sum(e.end - e.begin for e in episodes)
    for name, own, true, slack in (
        ("peak force", record.peak_force, kappa * max((e.depth for e in episodes), default=0.0), kappa * off),
        ("impulse", record.impulse, kappa * sum(e.area for e in episodes), kappa * off * (time + truth.time_tolerance)),
    ):
        if not np.isnan(own) and not abs(own - true) <= 1e-6 * true + slack:
            return f"{name} {own:.9g}, true {true:.9g}"
    slack = 1e-6 + 2.0 * len(episodes) * truth.time_tolerance / end
    if not np.isnan(record.fraction) and abs(record.fraction - time / end) > slack:
        return f"{record.fraction:.6g} of the time in contact, true {time / end:.6g}"
    return ""


def _peaks(
    impacts: Impacts, clear: list[Episode], deviation: np.ndarray, truth: Truth, i: int, window: tuple, method: str
) -> str:
    """Peaks and impulses where the motions agree well enough to tell."""
    kappa, tolerance = truth.case.contacts[i].kappa, truth.time_tolerance
    begin = np.array([e.begin for e in clear])
    for e in clear:
        near = np.flatnonzero((np.abs(impacts.times - e.begin) < tolerance) & (impacts.stops == e.side))
        if len(near) != 1 or np.sum(np.abs(begin - e.begin) < tolerance) != 1 or e.open or not e.end < window[1]:
            continue
        if e.begin <= window[0]:
            continue
        off = float(deviation[min(len(deviation) - 1, int(np.searchsorted(truth.t, e.end)))])
        off = 10.0 * off + 1e-12 * truth.reach[i]
        peak, impulse = impacts.peaks[near[0]], impacts.impulses[near[0]]
        if np.isnan(peak) and method not in TOUCH:
            continue
        if not abs(peak - kappa * e.depth) <= 1e-6 * kappa * e.depth + kappa * off:
            return f"peak {peak:.9g} of the impact at {e.begin:.6g}, true {kappa * e.depth:.9g}"
        if not abs(impulse - kappa * e.area) <= 1e-6 * kappa * e.area + kappa * off * (e.end - e.begin + tolerance):
            return f"impulse {impulse:.9g} of the impact at {e.begin:.6g}, true {kappa * e.area:.9g}"
    return ""


def judge_energy(ref: sb.Reference, truth: Truth, method: str, until: float) -> str:
    """The ledger closes, and its energy is that of the true motion."""
    ledger, inside = ref.energy, truth.t <= until
    turnover = np.max(np.abs(ledger.energy)) + np.max(np.abs(ledger.input)) + np.max(np.abs(ledger.viscous))
    if not np.all(np.isfinite(ledger.loss)):
        return "the ledger is not finite"
    off = np.max(np.abs(ref.tip - truth.tip)[inside], initial=0.0) / max(truth.scale, 1e-300)  # of the motion itself
    if np.max(np.abs(ledger.loss)) > (1e-6 + 10.0 * min(off, DISPLACEMENT)) * turnover:
        return f"the ledger is open by {np.max(np.abs(ledger.loss)) / turnover:.3g} of its turnover"
    true = truth.motion.energy(truth.t)
    good = inside & (truth.error <= 1e-7 * truth.scale) & (np.abs(ref.tip - truth.tip) <= 1e-7 * truth.scale)
    off = np.abs(ledger.energy - true)[good]
    if len(off) and np.max(off) > 1e-3 * np.max(true[good]) + 1e-12 * turnover:
        return f"energy off by {np.max(off) / np.max(true[good]):.3g} of its largest"
    return ""


def methods_for(case: Case, index: int) -> list[str]:
    """What is asked of a case: the exact solution always, the others in turn, the adaptive ones where they do not have
    too many periods of the fastest motion to follow."""
    able, turn = [method for method in ADAPTIVE if _affordable(case, method)], index // 12
    cheap = case.size <= 2 and case.notes not in ("long time", "several contacts")
    return ["exact", *able[turn % max(1, len(able)) :][:1], *(["multiprecision"] if turn % 2 and cheap else [])]


def _affordable(case: Case, method: str) -> bool:
    """Return True where an adaptive method has few enough periods of the fastest motion to follow."""
    flexible = [c.kappa * float(c.row @ np.linalg.solve(case.mass, c.row)) for c in case.contacts]
    phase = case.t_end * float(np.sqrt(case.frequencies[-1] ** 2 + sum(flexible)))
    return phase < {"radau": 1e3, "kvaerno5": 1e3, "dop853": 3e3}.get(method, 1e4)


def judged(seed: int, index: int, only: tuple[str, ...] = ()) -> tuple[str, list[Verdict]]:
    """The family of one system of a campaign, and the verdicts on it."""
    case = random_case(seed, index)
    return case.notes, [judge(case, method) for method in only or methods_for(case, index)]
