"""Rates of one long run at every contact, among them work rates for wear, with intervals that count its correlation.

    normal work rate     1/(T - s) int_s^T |F| |v| dt      v = velocity of the contact point against its stops
    sliding work rate    1/(T - s) int_s^T |F| |w| dt      w = tangent . q', the sliding velocity
    force rms            (1/(T - s) int_s^T F^2 dt)^(1/2)

Archard's law gives the worn volume as a wear coefficient times the sliding work. Limitation: there is no friction. The
sliding velocity is that of the motion without a tangential force, and F is the normal force.

An interval is mean +- t sqrt(V), V the variance of the mean over n parts of the run and N their effective number,

    V = gamma_0/N,    N = n/tau,    tau = -1 + 2 sum_m (gamma_2m + gamma_2m+1)/gamma_0 over the first positive sums,
    gamma_k = (autocovariance about the mean of the parts) + (1 - k/n) V

(Geyer, Practical Markov Chain Monte Carlo (1992), section 3.3). V in gamma_k is what the mean of the parts takes from
them; a few iterations find it. t is Student's for N - 1. A part is as long as two periods of the slowest motion, so
that its correlation does not swing; there are at most MOST of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import working
from ..basics.validation import InputError, instance, numbers, sequence
from ..model.scales import scales
from ..trajectory.ensemble import record_from
from ..trajectory.trajectory import Reference, Trajectory

if TYPE_CHECKING:
    import pandas

    from ..model.system import System

LEAST, MOST = 8, 200  # parts of a run
ITERATIONS, LEAST_TAU = 6, 0.1  # impacts that keep a distance from each other have tau < 1
CELLS, MOST_NODES = 243, 2_000_000  # nodes of the quadrature over a contact; over all contacts
RATES = {  # name: its column in a table
    "impact": "impact_rate", "impulse": "impulse_rate", "contact": "contact_fraction",
    "normal_work": "normal_work_rate", "sliding_work": "sliding_work_rate", "force_rms": "force_rms",
}  # fmt: skip
# Times (k,), weights (k,) of an integral over time, and at these times F, v and the sliding velocity.
Nodes = tuple[Array, Array, Array, Array, Array]


@dataclass(frozen=True)
class Mean:
    """Mean of a stationary series with the ends of its 95 % interval, and its effective sample size."""

    value: float
    low: float
    high: float
    effective: float

    def within(self, most: float = np.inf) -> Mean:
        """The mean with its interval cut at 0 and the largest value that is possible."""
        return Mean(self.value, float(np.maximum(0.0, self.low)), float(np.minimum(most, self.high)), self.effective)


def stationary_mean(series: ArrayLike) -> Mean:
    """Mean of a stationary series (n,) with its 95 % interval, from the effective sample size of its autocorrelation.

    A series with no more than two independent parts has an infinite interval. Limitation: few values do not show their
    correlation. Of 8 independent values the interval holds with 86 %, of 20 with 93 %; where the correlation lasts for
    a fifth of the series, less.
    """
    from scipy.stats import t as student

    x = numbers("series", series)
    n, mean = len(x), float(np.mean(x))
    off = x - mean
    # A constant series has no scatter.
    if not np.any(off):
        return Mean(mean, mean, mean, float(n))
    # Autocovariance by FFT of twice the length, so that the ends do not wrap; an even number of lags, for pairs.
    covariance = np.fft.irfft(np.abs(np.fft.rfft(off, 2 * n)) ** 2)[: n - n % 2] / n
    lags, effective, variance = np.arange(len(covariance)), float(n), 0.0
    for _ in range(ITERATIONS):
        # The mean of the parts lowers every covariance by about V, which itself follows from the covariances.
        gamma = covariance + (1.0 - lags / n) * variance
        # Geyer's rule: pairs of covariances count up to the first sum that is not positive; the rest is noise.
        pairs = (gamma / gamma[0]).reshape(-1, 2).sum(axis=1)[: max(1, n // LEAST)]
        first = int(np.argmax(np.append(pairs, -1.0) <= 0.0))
        effective = n / max(LEAST_TAU, 2.0 * float(np.sum(pairs[:first])) - 1.0)
        variance = gamma[0] / effective
    # Parts that alternate have an effective number above n; the degrees of freedom stay below n.
    half = float(student.ppf(0.975, min(effective, n) - 1.0) * np.sqrt(variance)) if effective > 2.0 else np.inf
    return Mean(mean, mean - half, mean + half, effective)


@dataclass(frozen=True)
class ContactRates:
    """Rates at every contact of a run.

    Parameters
    ----------
    rates : sequence of dict
        For each contact the Mean of ``impact`` (impacts per time), ``impulse`` (integral of |sigma| per time),
        ``contact`` (share of the time), ``normal_work`` and ``sliding_work`` (work per time) and ``force_rms``.
    sources : sequence of str
        For each contact the times at which F and v are known: every step of a scheme, quadrature between the events of
        a reference, or the output times; of rigid stops "impacts", with their impulses.
    """

    rates: tuple[Mapping[str, Mean], ...]
    sources: tuple[str, ...]

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each contact: ``impact_rate``, ``impact_rate_low``, ``impact_rate_high`` and so on.

        ``contact_fraction`` is the share of the time in contact.
        """
        import pandas

        columns: dict[str, Any] = {
            column + suffix: [getattr(each[name], end) for each in self.rates]
            for name, column in RATES.items()
            for end, suffix in (("value", ""), ("low", "_low"), ("high", "_high"))
        }
        return pandas.DataFrame(columns | {"source": list(self.sources)}).rename_axis("contact")

    def __str__(self) -> str:
        known = self.to_dataframe().dropna(axis="columns", how="all")
        return known.T.to_string(float_format="{:.4g}".format)


@working("integrating rates")
def contact_rates(
    run: Trajectory, since: float = 0.0, tangents: Sequence[ArrayLike | None] | None = None
) -> ContactRates:
    """Rates of impacts, impulse, normal work and sliding work, the fraction of the time in contact and the rms of the
    force, at every contact, each with its 95 % interval. That of the rate of fewer than 8 impacts is Poisson's.
    Limitation: the interval of a run of less than 40 periods of its slowest motion is too narrow, see
    ``stationary_mean``.

    Parameters
    ----------
    run : Trajectory
        One long run of a scheme, with every step on output, or a reference.
    since : float
        Time after which the motion counts as stationary.
    tangents : sequence of (n,) arrays, optional
        For each contact the row of its sliding velocity, tangent . q', or None. For a rotation of the section the
        row of the slope times the radius. Without it the sliding work is NaN.

    Returns
    -------
    ContactRates
        Of rigid stops, whose forces are impulses, all but the rates of impacts and impulse is NaN, and that of impulse
        too where one contact lasts longer than two periods.

    Raises
    ------
    InputError
        For a time ``since`` outside the run, thinned outputs, and rows that are not of the system.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> spring = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=400.0))
    >>> system = sb.System.from_matrices([[1.0]], [[4.0]], contacts=[spring], initial_velocity=[1.0])
    >>> rates = sb.contact_rates(sb.reference(system, 20.0))
    >>> round(rates.rates[0]["impact"].value, 2)  # a motion of period 1.75 has one impact each
    0.55
    """
    instance("run", run, Trajectory, "make one with integrate, reference or Trajectory.from_arrays")
    if run.provenance.get("every", 1) != 1:
        raise InputError("every", run.provenance["every"], "be 1 for rates", "integrate with every=1")
    end = float(run.provenance.get("t_end", run.t[-1]))
    record_from(since, end)
    rows = _tangents(run, tangents)
    edges = windows(run.system, since, end)
    width = edges[1] - edges[0]
    rates, sources = [], []
    for i, contact in enumerate(run.contacts):
        # Rigid stops have impulses, no forces. An impulse belongs to the part in which its contact begins.
        source, integrals = "impacts", np.full((5, len(edges) - 1), np.nan)
        if contact.stops.rigid:
            listed, _ = contact.impacts.listed()
            if np.all(listed.ends - listed.times <= width):
                integrals[0] = np.histogram(listed.times, edges, weights=listed.impulses)[0]
        else:
            source, nodes = _nodes(run, i, rows[i], edges)
            integrals = _integrals(edges, *nodes)
        sources.append(source)
        if rows[i] is None:
            integrals[3] = np.nan
        means = {"impact": _rate_of(contact.impacts.times, edges)}
        for name, series in zip(list(RATES)[1:], integrals / width, strict=True):
            mean = stationary_mean(series) if np.all(np.isfinite(series)) else Mean(*4 * (float("nan"),))
            means[name] = mean.within(1.0 if name == "contact" else np.inf)
        square = means["force_rms"]
        means["force_rms"] = Mean(square.value**0.5, square.low**0.5, square.high**0.5, square.effective)
        rates.append(means)
    return ContactRates(tuple(rates), tuple(sources))


def _integrals(edges: Array, t: Array, weights: Array, force: Array, v: Array, sliding: Array) -> Array:
    """Impulse, time in contact, normal and sliding work and the integral of F^2 over the parts between the edges, by
    the nodes of a quadrature in time; (5, parts)."""
    size, parts = weights * np.abs(force), len(edges) - 1
    columns = (size, np.where(force != 0.0, weights, 0.0), size * np.abs(v), size * np.abs(sliding),
               size * np.abs(force))  # fmt: skip
    # Entry 0 of the sums, nodes before the first edge, is cut off.
    place = np.clip(np.searchsorted(edges, t, "right") - 1, -1, parts - 1)
    return np.array([np.bincount(place + 1, column, parts + 1)[1:] for column in columns], float)


def windows(system: System | None, since: float, end: float) -> Array:
    """Edges of the parts of a run."""
    # Two periods a part, so that its correlation does not swing.
    parts = MOST if system is None else int((end - since) / (2.0 * scales(system, end).period) * (1 + 1e-12))
    return np.linspace(since, end, min(max(parts, LEAST), MOST) + 1)


def _rate_of(times: Array, edges: Array) -> Mean:
    """Rate of events at these times, from their counts between the edges; of fewer than LEAST by Poisson's law."""
    from scipy.stats import chi2

    counts, span = np.histogram(times, edges)[0], float(edges[-1] - edges[0])
    count = int(np.sum(counts))
    if count >= LEAST:
        return stationary_mean(counts / np.diff(edges)).within()
    low = 0.5 * float(chi2.ppf(0.025, 2 * count)) if count else 0.0
    high = 0.5 * float(chi2.ppf(0.975, 2 * count + 2))
    return Mean(count / span, low / span, high / span, float(count))


def _tangents(run: Trajectory, tangents: Sequence[ArrayLike | None] | None) -> list[Array | None]:
    """The rows of the sliding velocities, one a contact."""
    if tangents is None:
        return [None] * len(run.contacts)
    size = run.states[1].shape[1]
    given = sequence("tangents", tangents, f"have one entry for each of {len(run.contacts)} contacts")
    rows = [None if row is None else numbers("tangents", row) for row in given]
    if len(rows) != len(run.contacts) or not all(row is None or row.shape == (size,) for row in rows):
        rule = f"be a row of {size} numbers, or None, for each of {len(run.contacts)} contacts"
        raise InputError("tangents", tangents, rule, "of a reduced model pass row @ model.basis")
    return rows


def _nodes(run: Trajectory, i: int, tangent: Array | None, edges: Array) -> tuple[str, Nodes]:
    """Source of the forces of contact i, and the nodes of an integral over time."""
    contact = run.contacts[i]
    if isinstance(run, Reference) and run.evaluate is not None and contact.impacts.kind == "event":
        return "events", _between_events(run, i, tangent, edges)
    steps = np.diff(run.t, prepend=run.t[0], append=run.t[-1])
    sliding = np.full(len(run.t), np.nan) if tangent is None else run.states[1] @ tangent
    source = f"{len(run.t)} output times" if isinstance(run, Reference) else "every step"
    return source, (run.t, 0.5 * (steps[1:] + steps[:-1]), contact.force, contact.velocity, sliding)


def _between_events(run: Reference, i: int, tangent: Array | None, edges: Array) -> Nodes:
    """Midpoints of equal cells of every contact."""
    listed, _ = run.contacts[i].impacts.listed()
    ends = np.where(np.isnan(listed.ends), float(run.provenance["t_end"]), listed.ends)
    # Contacts are cut at the edges of the parts of the run.
    corners = np.sort(np.concatenate([listed.times, ends, edges]))
    last = np.searchsorted(listed.times, corners, "right") - 1
    closed = ((last >= 0) & (corners < np.append(ends, -np.inf)[last]))[:-1]
    left, width = corners[:-1][closed], np.diff(corners)[closed]
    cells = min(CELLS, max(1, MOST_NODES // max(1, len(left))))
    t = (left[:, None] + width[:, None] * (np.arange(cells) + 0.5) / cells).ravel()
    u, v = run.at(t, contact=i) if len(t) else (t, t)
    sliding = np.full(len(t), np.nan)
    if tangent is not None and len(t):
        assert run.state_at is not None
        sliding = run.state_at(t)[1] @ tangent
    return t, np.repeat(width / cells, cells), run.contacts[i].stops.force(u, v), v, sliding
