"""A system with some contacts closed, and all that drives it, as one linear system in many digits: z' = G z.

    z = (q, q', 1, sin w_1 t, cos w_1 t, ..., p, p', p'', p''' of every record)
    u = l z of a contact with its offset,   u' = l G z

The flow is split into blocks: those that float64 knows, refined to the digits carried.

    z = V y,   y' = T y,   T = L G V block by block,   L = V^-1
    V <- V (I + E),   E_ij T_jj - T_ii E_ij = T_ij

The second line is Newton's method, which squares its error at each turn. A pair of conjugate eigenvalues is a block
[[sigma, -omega], [omega, sigma]], which is one complex number, w' = lambda w. Eigenvalues that meet, and a drive in
resonance with them, share a block of any size, which moves by its matrix exponential. A block that is larger than
need be costs time and nothing else: what float64 cannot separate is joined.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import acb, arb, arb_mat, ctx

from ...basics.arrays import Array
from ...model.system import System
from ...model.time_functions import Drive
from .rational import channels, exact_problem, number, taylor

DERIVATIVES = 4  # of a record: it is a cubic between its samples


class LinearFlow:
    """Data that every regime of ``system`` shares, at the current precision.

    forms: the positions of all channels, (1, N) each, the contacts first; rates: of these. back: M^-1 row^T (N, m),
    a unit of impulse on each contact as a change of z.
    """

    def __init__(self, system: System) -> None:
        self.drive = Drive.of(system)
        self.problem = problem = exact_problem(system, self.drive)
        n, d, records = system.size, self.drive.size, len(self.drive.records)
        self.n, self.N = n, 2 * n + d + DERIVATIVES * records
        m = len(problem.contacts)
        rows = arb_mat(m, n, [x for contact in problem.contacts for x in contact.row])
        inverse = problem.mass.inv()
        back = inverse * rows.transpose()
        self.back = arb_mat([[arb(0)] * m for _ in range(n)] + back.mid().tolist() + [[arb(0)] * m] * (self.N - 2 * n))
        self.forms = [
            self._form(row, offset, recorded) for row, offset, recorded in channels(system, problem, self.drive)
        ]
        # G: the equation of motion with its loads, then the equations of the functions of time.
        pulls = (inverse * problem.stiffness).tolist(), (inverse * problem.damping).tolist()
        loads = (inverse * problem.basis.transpose()).tolist()
        of_records = (inverse * arb_mat(problem.records).transpose()).tolist() if records else [[]] * n
        G = [[arb(0)] * self.N for _ in range(self.N)]
        for i in range(n):
            G[i][n + i] = arb(1)
            G[n + i][: 2 * n] = [-x for x in (*pulls[0][i], *pulls[1][i])]
            G[n + i][2 * n : 2 * n + d] = loads[i]
            for r, x in enumerate(of_records[i]):
                G[n + i][2 * n + d + DERIVATIVES * r] = x
        for k, frequency in enumerate(self.drive.frequencies):
            at, w = 2 * n + 1 + 2 * k, arb(number(frequency))
            # (sin w t)' = w cos w t, (cos w t)' = -w sin w t.
            G[at][at + 1], G[at + 1][at] = w, -w
        for at in range(2 * n + d, self.N):
            # The rate of a derivative is the next one; the last is constant up to the next sample.
            if (at - 2 * n - d) % DERIVATIVES < DERIVATIVES - 1:
                G[at][at + 1] = arb(1)
        self.G = arb_mat(G).mid()
        self.rates = [(form * self.G).mid() for form in self.forms]

    def _form(self, row: list[Any], offset: list[Any], recorded: list[Any]) -> Any:
        tail = [x for weight in recorded for x in (weight, *[0] * (DERIVATIVES - 1))]
        return arb_mat([[arb(x) for x in (*row, *[0] * self.n, *offset, *tail)]]).mid()

    def start(self) -> Any:
        """z (N, 1) at t = 0."""
        values = [*self.problem.q0, *self.problem.v0, arb(1)]
        for _ in self.drive.frequencies:
            # sin 0 and cos 0.
            values += [arb(0), arb(1)]
        z = arb_mat([[x] for x in [*values, *[arb(0)] * (self.N - len(values))]])
        return self.at_edge(z, arb(0))

    def at_edge(self, z: Any, t: Any) -> Any:
        """z with the records' polynomials from time t on."""
        values, at = z.entries(), 2 * self.n + self.drive.size
        for r, record in enumerate(self.drive.records):
            c = taylor(record, t)
            for k in range(DERIVATIVES):
                # A Taylor coefficient times k! is the derivative.
                values[at + DERIVATIVES * r + k] = c[k] * math.factorial(k) if k < len(c) else arb(0)
        return arb_mat([[x] for x in values]).mid()

    def closed(self, sides: Sequence[int]) -> Any:
        """G with compliant contacts on the given sides, 0 free: sigma = kappa (g - u) - c u'."""
        G = self.G
        for c, (contact, side) in enumerate(zip(self.problem.contacts, sides, strict=True)):
            if side:
                force = self.gap(c, side) * -contact.kappa - self.rates[c] * contact.damping
                G = (G + arb_mat([[line[c]] for line in self.back.tolist()]) * force).mid()
        return G

    def gap(self, contact: int, side: int, lagging: bool = False) -> Any:
        """u - g of a contact, or u - g + (c/kappa) u', a form."""
        entries = self.forms[contact].entries()
        entries[2 * self.n] -= self.problem.contacts[contact].stop(side)
        form = arb_mat([entries]).mid()
        return form + self.rates[contact] * self.problem.contacts[contact].lag if lagging else form


START_BITS = 120  # of the first turn, which begins with the 53 of float64
MAX_TURNS = 40
TOO_FAR = 0.1  # an entry of E: blocks with larger ones are joined
CLOSE = 1e-6  # of their size: eigenvalues of a mode and of a drive that are in resonance
NOTHING = 1e-9  # of the largest eigenvalue


class Block(NamedTuple):
    """Places in y, and the eigenvalues by float64; one conjugate pair, or any."""

    places: list[int]
    values: list[complex]
    pair: bool

    def __add__(self, other: Block) -> Block:  # type: ignore[override]
        return Block(self.places + other.places, self.values + other.values, pair=False)


class Split:
    """The flow of G (N, N) in ``blocks``, at the current precision, from a V (N, N) that is known to ``bits``.

    Of the coordinates those from ``drives`` on depend on themselves alone; their columns may begin as unit vectors.
    """

    def __init__(self, G: Any, V: Any, blocks: list[Block], drives: int, bits: int = 0) -> None:
        self.G, self.V, self.N, self.blocks, self.drives = G, V, G.nrows(), blocks, drives
        # Refine. Blocks that cannot be separated are joined, and the refinement starts anew from the V it was given.
        target = ctx.prec
        try:
            while apart := self._refine(target, max(START_BITS, 2 * bits)):
                self.V = V
                self._join(*apart)
        finally:
            ctx.prec = self.bits = target
        identity = arb_mat([[arb(int(i == j)) for j in range(self.N)] for i in range(self.N)])
        self.L = self.V.solve(identity, algorithm="approx").mid()
        # A pair moves by one complex exponential, any other block by that of its matrix.
        self._pairs = [(*block.places, self._diagonal[block.places[0]]) for block in self.blocks if block.pair]
        self._rest = [(block.places, self._diagonal[block.places[0]]) for block in self.blocks if not block.pair]

    def ahead(self, y: Any, tau: Any) -> Any:
        """y (N, 1) at tau later."""
        y = y.entries()
        for a, b, rate in self._pairs:
            w = acb(y[a], y[b]) * (rate * tau).exp()
            y[a], y[b] = w.real, w.imag
        for places, T in self._rest:
            part = (T * tau).exp() * arb_mat([[y[k]] for k in places])
            for k, x in zip(places, part.entries(), strict=True):
                y[k] = x
        return arb_mat(self.N, 1, y)

    def _join(self, i: int, j: int) -> None:
        """Blocks i <= j, or a pair that is none."""
        both = self.blocks[i]._replace(pair=False) if i == j else self.blocks[i] + self.blocks[j]
        self.blocks = [*self.blocks[:i], both, *(x for k, x in enumerate(self.blocks) if k > i and k != j)]

    def again(self, G: Any) -> Split:
        """The split of another G, with other drives or more known digits."""
        return Split(G, self.V, self.blocks, self.drives, self.bits)

    def _refine(self, target: int, precision: int) -> tuple[int, int] | None:
        """Refine V; two blocks that cannot be separated, None where all are."""
        size = arb(1)
        for turn in range(MAX_TURNS):
            ctx.prec = min(target, precision)
            # T in the present coordinates, and the correction E that makes it block by block.
            T = self.V.solve(self.G * self.V, algorithm="approx").mid().tolist()
            self._diagonal = dict(self._parts(T))
            E = [[arb(0)] * len(T) for _ in T]
            largest, worst = arb(0), (0, 0)
            for i, j, places, entries in self._steps(T):
                for (a, b), x in zip(places, entries, strict=True):
                    if not x.is_finite():
                        return min(i, j), max(i, j)
                    E[a][b] = x
                    if turn == 0 and b >= self.drives:  # of any size: how far a drive moves the modes
                        size = abs(x) if abs(x) > size else size
                    elif not abs(x) / size <= largest:
                        largest, worst = abs(x) / size, (min(i, j), max(i, j))
            # Newton's method converges from small corrections only: larger ones mean blocks too close to separate.
            if turn == MAX_TURNS - 1 or not largest < TOO_FAR:
                return worst
            self.V = (self.V + self.V * arb_mat(E)).mid()
            # The next error is the square of this one, and the one after that has to be carried.
            bits = target if largest == 0 else math.floor(-float(largest.log()) / math.log(2.0))
            if ctx.prec == target and 2 * bits > target - 40 and (turn > 0 or precision > START_BITS):
                return None
            precision = max(START_BITS, 4 * bits + 120)
        return None

    def _parts(self, T: list[list[Any]]) -> Iterator[tuple[int, Any]]:
        """The blocks of T by their first places: lambda of a pair, else a matrix."""
        for places, _, pair in self.blocks:
            if pair:
                a, b = places
                rate = acb((T[a][a] + T[b][b]) / 2, (T[b][a] - T[a][b]) / 2).mid()
                decays = abs(rate.real) > abs(rate.imag) * arb(2) ** (-7 * ctx.prec // 8)  # or that is rounding
                yield a, rate if decays else acb(0, rate.imag)
            else:
                yield places[0], arb_mat([[T[a][b] for b in places] for a in places])

    def _steps(self, T: list[list[Any]]) -> Iterator[tuple[int, int, list[tuple[int, int]], list[Any]]]:
        """E of blocks i, j by its places, where it is not 0 for certain."""
        for i, one in enumerate(self.blocks):
            # The functions of time depend on themselves alone: nothing of the motion enters their rows.
            if min(one.places) >= self.drives:
                continue
            mine = self._diagonal[one.places[0]]
            for j, other in enumerate(self.blocks):
                places = [(a, b) for a in one.places for b in other.places]
                if i == j and not one.pair:
                    continue
                if i == j:  # what keeps a pair from its form joins w to its conjugate
                    (a, b), rate = one.places, mine
                    x = acb(T[a][a] - T[b][b], T[b][a] + T[a][b]) / acb(0, -4 * rate.imag)
                    yield i, j, places, [x.real.mid(), x.imag.mid(), x.imag.mid(), -x.real.mid()]
                elif one.pair and other.pair:
                    # A column of E_ij is one complex number: two columns, two linear equations.
                    (a, b), (c, d), rate = one.places, other.places, self._diagonal[other.places[0]]
                    apart, omega = rate.real - mine, rate.imag
                    scale = 1 / (apart * apart + omega * omega)
                    x, y = acb(T[a][c], T[b][c]) * scale, acb(T[a][d], T[b][d]) * scale
                    x, y = (apart * x - omega * y).mid(), (omega * x + apart * y).mid()
                    yield i, j, places, [x.real, y.real, x.imag, y.imag]
                else:
                    yield i, j, places, self._sylvester(T, one, other)

    def _sylvester(self, T: list[list[Any]], one: Block, other: Block) -> list[Any]:
        """E_ij of blocks of any size, line by line."""
        places = [(a, b) for a in one.places for b in other.places]
        matrix = [[(T[d][b] if a == c else 0) - (T[a][c] if b == d else 0) for c, d in places] for a, b in places]
        try:
            entries = arb_mat(matrix).solve(arb_mat([[T[a][b]] for a, b in places]))
        except ZeroDivisionError:
            # An infinite entry makes ``_refine`` join the two blocks.
            return [arb("inf")] * len(places)
        return entries.mid().entries()


def with_drives(modes: Sequence[Block], drives: Sequence[Block]) -> list[Block]:
    """All blocks from float64. Blocks are joined if eigenvalues of their modes and drives meet."""
    blocks, alone = list(modes), []
    nothing = NOTHING * max(abs(x) for block in (*modes, *drives) for x in block.values)
    for drive in drives:
        # In resonance: the drive and the modes with its eigenvalue share a block.
        near = [block for block in blocks if _meet(block, drive, nothing)]
        blocks = [block for block in blocks if block not in near]
        if near:
            blocks.append(sum(near[1:], near[0]) + drive)
        else:
            alone.append(drive)
    return blocks + alone


def _meet(block: Block, drive: Block, nothing: float) -> bool:
    pairs = ((x, y) for x in block.values for y in drive.values)
    return any(abs(x - y) <= CLOSE * (abs(x) + abs(y)) + nothing for x, y in pairs)


def by_float64(flow: LinearFlow, G: Any) -> tuple[Any, list[Block]]:
    """Columns V (N, N) and blocks of a regime by float64, and of the drives behind it: the constant, sine and cosine of
    every frequency, and the derivatives of every record."""
    n, V = flow.n, np.eye(flow.N)
    A = np.array([[float(x) for x in line[: 2 * n]] for line in G.tolist()[: 2 * n]])
    # Positions in units that bring both halves of A to one size.
    unit = np.repeat([math.sqrt(float(np.linalg.norm(A[n:, :n], 2))) or 1.0, 1.0], n)
    A *= unit[:, None] / unit
    values: Any
    vectors: Any
    values, vectors = np.linalg.eig(A)
    columns: list[Array] = []
    modes = []
    for group in _groups(values):
        own, begin = values[group], len(columns)
        pair = len(group) == 1 and bool(own[0].imag > CLOSE * abs(own[0]))
        both = np.concatenate([own, own[own.imag > 0.0].conj()])
        if pair:  # real and imaginary part of an eigenvector
            columns += [vectors[:, group[0]].real, -vectors[:, group[0]].imag]
        elif len(both) == 1:
            columns.append(vectors[:, group[0]].real)
        else:  # eigenvalues that meet share the kernel of their polynomial
            P = np.eye(2 * n)
            for x in own:
                step = A - x.real * np.eye(2 * n)
                P = P @ (step @ step + x.imag**2 * np.eye(2 * n) if x.imag > 0.0 else step)
                P /= np.max(np.abs(P)) or 1.0
            columns += list(np.linalg.svd(P)[2][-len(both) :])
        modes.append(Block(list(range(begin, len(columns))), both.tolist(), pair))
    V[: 2 * n, : 2 * n] = np.transpose(columns) / unit[:, None]
    # Drives: the constant, sine and cosine of every frequency, the derivatives of every record.
    drives = [Block([2 * n], [0.0], False)]
    for k, frequency in enumerate(flow.drive.frequencies):
        places = [2 * n + 1 + 2 * k, 2 * n + 2 + 2 * k]
        drives.append(Block(places, [1j * frequency, -1j * frequency], True))
    for begin in range(2 * n + flow.drive.size, flow.N, DERIVATIVES):
        drives.append(Block(list(range(begin, begin + DERIVATIVES)), [0.0], False))
    return arb_mat([[arb(x) for x in line] for line in V.tolist()]), with_drives(modes, drives)


def _groups(values: Any) -> list[list[int]]:
    """Numbers of eigenvalues in the upper half plane, in groups of those that meet, or meet their conjugates."""
    upper = [k for k, x in enumerate(values.tolist()) if x.imag >= 0.0]
    nothing, groups = NOTHING * float(np.max(np.abs(values))), list[list[int]]()
    for k in upper:
        x = values[k]
        near = [g for g in groups if any(abs(values[j] - x) <= CLOSE * (abs(values[j]) + abs(x)) + nothing for j in g)]
        groups = [g for g in groups if g not in near] + [[*(j for g in near for j in g), k]]
    return groups
