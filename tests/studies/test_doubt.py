"""The budget of doubt: coverage of its intervals, sources against single runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from systems import one_mass

import stiffbeam as sb
from stiffbeam.files.cases import Case, case_of
from stiffbeam.studies.doubt import deviation, drawn_members, finer_mesh, interval, largest_of, share

CASES = 300
LEAST, MOST = 0.91, 0.985  # of 300 intervals of 95 %: three deviations of the count, 1.26 %, and what BCa lacks at 48


def doubted(case, scheme="HHT(alpha=-0.1)", members=8, **options):
    """Records, and the rows of a quantity by source."""
    records = sb.study("doubt", case, scheme=scheme, members=members, **options)
    table = records.table.set_index(["quantity", "source"])
    return records, lambda quantity: table.loc[quantity]


def dominant(rows) -> str:
    """The source that is named alone, "" for several."""
    return " or ".join(largest_of({x.Index: (x.value, x.low, x.high) for x in rows.itertuples()}))


def ball(stiffness: float = 1e4) -> sb.System:
    """A mass 2 that meets a spring with the speed 3: largest force 3 sqrt(2 kappa)."""
    stops = sb.Stops(None, 0.1, stiffness=stiffness)
    return one_mass(0.0, stops, mass=2.0, v=3.0)


@pytest.mark.slow
def test_the_interval_of_a_scatter_covers_the_known_one():
    """Forces sqrt(kappa), kappa uniform within 30 %: mean and mean square are integrals of powers of kappa."""
    tolerance, system = 0.3, ball()
    low, high = 1.0 - tolerance, 1.0 + tolerance
    mean = (high**1.5 - low**1.5) / 1.5 / (2 * tolerance)
    known = np.sqrt(1.0 - mean**2) / mean  # the mean of kappa itself is 1
    inside = 0
    for seed in range(CASES):
        values = 1e4 * np.random.default_rng(seed).uniform(low, high, 48)
        forces = 3.0 * np.sqrt(2.0 * values)
        if not seed:
            exact = sb.reference_ensemble(system, 0.2, sb.varied_members(system, {"stops.stiffness": values}))
            np.testing.assert_allclose(exact.contacts[0].peak_force, forces, rtol=1e-9)
        part = share(forces, float(np.mean(forces)), deviation)
        inside += part[1] <= known <= part[2]
    assert LEAST <= inside / CASES <= MOST


@pytest.mark.parametrize("law", ["normal", "exponential"])
def test_the_interval_of_a_mean_shift_covers_the_known_one(law):
    """The scheme's error in 300 ensembles of 48 members, whose mean is known: 0.05 of 1."""
    rng, inside = np.random.default_rng(7), 0
    for _ in range(CASES):
        error = 0.05 + 0.02 * (rng.normal(size=48) if law == "normal" else rng.exponential(size=48) - 1.0)
        low, high = interval(error)
        inside += low <= 0.05 <= high
    assert LEAST <= inside / CASES <= MOST


def test_sources_that_may_be_the_largest_are_named_together():
    """Normal errors whose means are apart by many deviations of the mean or by none; data contain rounding."""
    noise, zero = np.random.default_rng(5).normal(size=(3, 40)), np.zeros(40)
    none = {"rounding": (zero, 1.0, deviation), "data": (zero, 1.0, deviation)}

    def named(**shares):
        return largest_of({name: share(*one) for name, one in (none | shares).items()})

    small, large = 0.05 + 0.02 * noise[0], -0.08 - 0.02 * noise[1]
    rounding = noise[0], 1.0, deviation
    assert named(scheme=(small, 1.0), mesh=(large, 1.0)) == ("mesh",)
    assert named(scheme=(small, 1.0), mesh=(large, 1.0, np.mean, (1.0, 0.6, 1.4))) == ("mesh", "scheme")
    assert named(scheme=(zero, 1.0), data=(np.append(zero[1:], 1.0), 1.0, deviation)) == ("data",)
    assert named(rounding=rounding, scheme=(small, 1.0), data=(1.02 * noise[1], 1.0, deviation)) == ("rounding",)
    assert named(rounding=rounding, scheme=(small, 1.0), data=(3.0 * noise[1], 1.0, deviation)) == ("data",)


def test_the_energy_of_members_that_swing_freely():
    """E = x k a^2/2 for a factor x of the stiffness, at all times; the trapezoidal rule keeps it."""
    system = sb.System.from_matrices([[2.0]], [[8.0]], initial_displacement=[0.5], observe=[1.0])
    case = replace(case_of(system, 0.01, 2.0), uncertain={"stiffness.scale": (0.9, 1.1)})
    energy = doubted(case, "Trapezoidal()", 20)[1]("energy")
    factors = drawn_members(system, case.uncertain, 20).parameters["stiffness.scale"]
    assert energy["mean"].iloc[0] == pytest.approx(np.mean(factors))
    assert energy.value["data"] == pytest.approx(np.std(factors, ddof=1) / np.mean(factors), rel=1e-9)
    assert dominant(energy) == "data"
    assert energy.value["scheme"] < 1e-9


def around(value: float, tolerance: float) -> tuple[float, float]:
    return value * (1.0 - tolerance), value * (1.0 + tolerance)


def beam(cells: int, dt: float, tolerance: float) -> Case:
    """A beam thrown at its stop, to after the impact."""
    problem = sb.BeamProblem(
        stiffness=3.0, viscosity=0.02, stops=sb.Stops(None, 0.02, stiffness=400.0),
        initial_velocity=sb.PolynomialProfile((0.0, 0.0, 0.5)),
    )  # fmt: skip
    case = case_of(sb.semidiscretise(problem, cells), dt, 0.6, "thrown")
    return replace(case, uncertain={"stiffness": around(3.0, tolerance)})


SOURCES = {"scheme": (24, 1.5e-2, 1e-6), "mesh": (4, 1e-4, 1e-6), "data": (24, 1e-4, 0.2)}


@pytest.mark.fast(1)
@pytest.mark.parametrize("source", SOURCES)
def test_the_source_that_is_large_by_construction_is_named(source):
    cells, dt, tolerance = SOURCES[source]
    records, result = doubted(beam(cells, dt, tolerance), members=12)
    assert records.table.horizon[0] == 0.6
    assert f" {source} for tip" in records.answer.verdict
    for quantity in ("tip", "impulse", *(["largest force"] if source != "data" else [])):
        assert dominant(result(quantity)) == source, str(records)
        assert result(quantity).high["rounding"] == 0.0
    exact, fine = (
        sb.reference(sb.semidiscretise(beam(cells, dt, tolerance).problem, n, form), 0.6).contacts[0].peak_force
        for n, form in ((cells, "displacement"), (max(cells, 8), "hermite"))
    )
    run = sb.integrate(beam(cells, dt, tolerance).system(), sb.HHT(-0.1), dt, 0.6)
    shares = result("largest force")
    if source != "data":  # the members are the nominal beam but for a millionth
        assert shares.value["scheme"] == pytest.approx(abs(run.contacts[0].peak_force / exact - 1.0), rel=0.02)
        assert shares.value["mesh"] == pytest.approx(abs(fine / exact - 1.0), rel=0.02)
        assert shares.low["mesh"] == pytest.approx(shares.value["mesh"] * 0.9, rel=0.02)
        assert shares.high["mesh"] == pytest.approx(shares.value["mesh"] * 1.1, rel=0.02)
    else:
        each = [
            sb.reference(sb.semidiscretise(replace(beam(24, dt, 0.2).problem, stiffness=x), 24), 0.6)
            for x in drawn_members(beam(24, dt, 0.2).system(), {"stiffness": around(3.0, 0.2)}, 12).parameters[
                "stiffness"
            ]
        ]
        forces = [one.contacts[0].peak_force for one in each]
        assert shares.value["data"] == pytest.approx(np.std(forces, ddof=1) / np.mean(forces), rel=1e-6)


def random_beam(number: int, cells: int, form: str) -> Case:
    """A random beam between stops at its tip."""
    rng = np.random.default_rng([900, number, 37])
    gap, load = rng.uniform(0.002, 0.01), sb.Harmonic(0.3 * rng.uniform(0.5, 1.5), rng.uniform(4.0, 20.0))
    problem = sb.BeamProblem(
        stiffness=rng.uniform(1.0, 5.0), viscosity=0.005, loads=(sb.PointLoad(0.7, load),),
        stops=sb.Stops(-gap, gap, stiffness=10 ** rng.uniform(2.0, 3.3)),
    )  # fmt: skip
    return case_of(sb.semidiscretise(problem, cells, form), 9e-4, 0.9, "random")


@pytest.mark.parametrize(
    ("form", "cells", "beams"),
    [
        pytest.param("displacement", 4, 6, marks=pytest.mark.slow),
        pytest.param("displacement", 8, 40, marks=pytest.mark.campaign),
        pytest.param("hermite", 4, 4, marks=pytest.mark.campaign),
    ],
)
def test_the_bracket_of_the_mesh_holds_the_error_against_eight_times_as_many_cells(form, cells, beams):
    """Exact motions of random beams on the mesh, on the finer one and on 8 times the cells: 9 in 10 are inside."""
    t, inside = np.linspace(0.0, 0.9, 401), list[bool]()
    for number in range(beams):
        case = random_beam(number, cells, form)
        finer, of_mesh = finer_mesh(case, form)
        systems = case.system(form), finer, replace(case, cells=8 * cells).system(form)
        motions = [sb.reference(system, 0.9, t_eval=t) for system in systems]
        tips, size = [x.tip for x in motions], np.max(np.abs(motions[2].tip))
        columns = [[np.sqrt(np.mean((tip - tips[0]) ** 2)) / size for tip in tips]]
        columns += [[getattr(x.contacts[0], name) for x in motions] for name in ("peak_force", "impulse", "fraction")]
        for coarse, fine, eight in columns:
            _, low, high = share(np.full(8, fine - coarse), 1.0, factors=of_mesh)
            inside.append(low <= abs(eight - coarse) <= high)
    assert np.mean(inside) >= (0.9 if cells == 8 else 0.7)


def test_rigid_stops_have_no_largest_force():
    """A mass thrown at 3 from 0 onto a stop at g, e = 1/2: the impulse is 2 (3 + 3/2), whatever the gap."""
    stops = sb.Stops(None, 0.1, stiffness=np.inf, restitution=0.5)
    system = one_mass(0.0, stops, mass=2.0, v=3.0)
    case = replace(case_of(system, 1e-4, 0.2), uncertain={"stops.upper": (0.09, 0.11)})
    records, result = doubted(case, sb.MoreauJean(), 10)
    assert list(records.table.quantity.unique()) == ["tip", "impacts", "impulse", "time in contact", "energy"]
    assert result("impulse")["mean"].iloc[0] == pytest.approx(9.0)
    assert dominant(result("tip")) == "data"


def test_matrices_have_no_mesh_and_a_case_without_tolerances_is_refused(tmp_path):
    case = case_of(ball(), 1e-4, 0.2)
    with pytest.raises(sb.InputError, match=r"have uncertain parameters.*case.uncertain"):
        doubted(case)
    records, result = doubted(case, members=16, uncertain={"stops.stiffness": (9e3, 1.1e4)}, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3  # one for each source, so that an interrupt loses one
    assert set(result("largest force").index) == {"rounding", "scheme", "data"}
    assert "(mesh not known)" in records.answer.verdict
    assert dominant(result("largest force")) == "data"
    assert "none for impacts" in records.answer.verdict
    assert records.figure().axes[0].get_xlabel()


def test_finished_points_are_those_of_a_distribution(tmp_path):
    """An equal one reads them, another one does not."""
    case, files = case_of(ball(), 1e-3, 0.2), []
    for mean in (1e4, 1e4, 2e4):
        doubted(case, uncertain={"stops.stiffness": norm(mean, 100.0)}, folder=tmp_path)
        files.append(len(list(tmp_path.glob("*.json"))))
    assert files[0] == files[1] < files[2]


def test_members_are_drawn_from_ranges_and_distributions_of_scipy():
    """A Latin hypercube sample has one value in each of 40 intervals of equal probability."""
    paths = {"stops.stiffness": norm(1e4, 1e3), "stops.upper": (0.05, 0.15)}
    members = drawn_members(ball(), paths, 40, rng=3)
    values = np.array([[each.contacts[0].stops.stiffness, each.contacts[0].stops.upper] for each in members])
    shares = norm.cdf(values[:, 0], 1e4, 1e3), (values[:, 1] - 0.05) / 0.1
    assert all(sorted((40 * x).astype(int)) == list(range(40)) for x in shares)
    for wrong, words in (
        ({"stops.stiffness": 0.1}, "range"),
        ({"stops.upper": (0.2, 0.1)}, "range"),
        ({"stops.kappa": (1.0, 2.0)}, "path"),
    ):
        with pytest.raises(sb.InputError, match=words):
            drawn_members(ball(), wrong, 8)
