"""What tables, pictures and files show of schemes and numbers: units beside them, one look for each name, orders."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.colors import rgb_to_hsv, to_rgb

import stiffbeam as sb
from dumont2002 import figures as page
from stiffbeam.basics.units import unit_of
from stiffbeam.figures import chart
from stiffbeam.figures.chart import EXACT, look
from stiffbeam.figures.runs import comparison_panels
from stiffbeam.files.cases import Case
from stiffbeam.measures.amplification import free_mode_errors
from stiffbeam.measures.errors import observed_order
from stiffbeam.measures.report import report
from stiffbeam.model.modes import modes
from stiffbeam.schemes import RIGID, SCHEMES, registered
from stiffbeam.trajectory.trajectory import Trajectory, Work

BEAM = {"stops": sb.Stops(-2e-3, 2e-3, stiffness=1e5), "base": sb.Harmonic(2e-3, 150.0)}
STEEL = sb.BeamProblem.from_physical(length=0.4, bending_stiffness=4.2, mass_per_length=0.16, **BEAM)
PLAIN = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e4), base=sb.Harmonic(0.2, 10.0))
RUNS = ((sb.HHT(-0.1), "displacement"),)
LABELS = [str(scheme) for scheme in registered()]
# What each study is asked, what its answer says and what its axes say of the steel beam.
STUDIES = {
    "sweep": ({"values": [140.0, 160.0], "periods": 2, "transient": 1}, ["(N)"],
              ["(rad/s)", "(N)", "(m)"]),
    "energy": ({"schemes": LABELS[:1]}, ["to t = 0.1"], ["(s)", "(J)"]),
    "chaos": ({"schemes": LABELS[:1], "starts": 8}, ["(1/s)", "digits per s"], ["(s)", "(1/s)"]),
    "ensemble": ({"schemes": LABELS[:1], "members": 3}, ["per s", "(N)", "(J)"],
                 ["(N)", "(J)", "(rad/s)", "(m)"]),
    "rigid": ({"factors": [16.0, 256.0, 4096.0], "impacts": 2}, ["(N/m)"], ["(N/m)", "time (s)", "force (N)", "(m)"]),
    "converge": ({"integrators": LABELS[:1], "halvings": 3, "impacts": 1, "kinds": ["smooth"]}, [], ["(s)"]),
}  # fmt: skip


def words_of(figure) -> list[str]:
    """Every label and title of a picture."""
    axes = [text for axis in figure.axes for text in (axis.get_xlabel(), axis.get_ylabel(), axis.get_title("left"))]
    return [figure.get_suptitle(), *axes]


@pytest.mark.fast(3)
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_of_a_physical_case_names_its_units(name):
    options, answered, drawn = STUDIES[name]
    records = sb.study(name, Case("steel", "steel", STEEL, 8, 1e-4, 0.6 if name == "chaos" else 0.1, RUNS), **options)
    words = words_of(records.figure())
    assert not records.lost
    assert all(text in str(records) for text in answered)
    for text in drawn:
        assert any(text in word for word in words), (text, words)
    assert not any("u(1," in word for word in words)  # the tip is at L
    assert records.to_dict()["units"] == ["m", "s", "N"]


def test_a_study_of_a_case_without_units_names_none():
    case = Case("plain", "plain", PLAIN, 8, 1e-3, 1.0, RUNS)
    words = words_of(sb.study("sweep", case, values=[9.0, 10.0], periods=2, transient=1).figure())
    assert "tip $u(1, nT)$" in words
    assert not re.search(r"\((m|s|N|rad/s|Hz)\)", "".join(words))


def test_a_comparison_and_a_file_name_the_unit_of_every_number(tmp_path):
    def compared(system, dt, t_end):
        run, reference = sb.integrate(system, sb.HHT(-0.1), dt, t_end), sb.reference(system, t_end)
        return run, reference, str(report([sb.compare(run, reference)]))

    run, reference, text = compared(sb.semidiscretise(STEEL, 8), 1e-4, 0.1)
    assert all(words in text for words in ("(N)", "(N s)", "(s)"))
    words = words_of(comparison_panels("steel", [run], [reference]))
    for text in ("tip displacement $u(L, t)$ (m)", "max |$u(L, t)$|", "time $t$ (s)", "a = 150"):
        assert any(text in word for word in words), text
    assert run.energy.energy[-1] > 0.0  # so that the ledger is written
    data = run.to_xarray()
    units = {str(name): data[name].attrs["units"] for name in data.variables if "units" in data[name].attrs}
    wanted = {"time": "s", "impact_time": "s", "tip": "m", "tip_velocity": "m/s", "contact_force": "N",
              "impact_peak_force": "N", "impact_impulse": "N s", "contact_impulse": "N s", "energy_kinetic": "J",
              "contact_fraction": "1"}  # fmt: skip
    assert wanted.items() <= units.items()
    for one in (run, reference):
        assert sb.load(one.save(tmp_path / "run.nc")).units == ("m", "s", "N")
    assert np.allclose(run.displacement(0.4), run.tip, atol=1e-15)  # along its own length
    plain, _, text = compared(sb.semidiscretise(PLAIN, 8), 1e-3, 0.5)
    assert "(N)" not in text
    assert "units" not in plain.to_xarray()["tip"].attrs
    contact = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=1e4))
    run, _, text = compared(
        sb.System.from_matrices([[1.0]], [[100.0]], contacts=[contact], initial_velocity=[2.0]), 1e-3, 1.0
    )
    assert "mesh" not in text
    assert "units" not in run.to_xarray()["tip"].attrs


def test_a_new_scheme_changes_no_other_look():
    """A name has its colour and dashes wherever the registry puts it; the page's are the same, in shades."""
    before, kept = {label: look(label) for label in LABELS}, dict(SCHEMES)
    try:
        for place in (0, 3, len(kept)):
            entries = list(kept.items())
            entries.insert(place, ("newcomer", type("Newcomer", (sb.BDF2,), {"name": "newcomer"})))
            SCHEMES.clear()
            SCHEMES.update(entries)
            assert {label: look(label) for label in LABELS} == before
            new = look("newcomer")
            assert all(
                (new["linestyle"], new["marker"]) != (x["linestyle"], x["marker"]) for x in map(look, chart.LOOKS)
            )
    finally:
        SCHEMES.clear()
        SCHEMES.update(kept)
    for equation, label in (("(4.13)", "hht"), ("(4.11)", "bdf2"), ("(4.14)", "sdirk")):
        colour, dashes = page.STYLE[equation]
        assert colour == look(label)["color"]
        assert look(label)["linestyle"] == ((0, dashes) if dashes else "-")
    for equation, its in page.EQUATIONS.items():
        hue = rgb_to_hsv(to_rgb(page.STYLE[equation][0]))[0]
        assert hue == pytest.approx(rgb_to_hsv(to_rgb(look(its.scheme)["color"]))[0], abs=0.02)


def test_looks_can_be_told_apart_in_grey_and_the_exact_motion_is_black():
    dashes = [look(name)["linestyle"] for name in chart.LOOKS]
    assert len(set(map(str, dashes))) == len(dashes) == len(chart.DASHES)
    assert {*SCHEMES, *RIGID} <= set(chart.LOOKS)
    assert {look(label)["color"] for label in EXACT} == {colour for colour, _ in page.EXACT.values()} == {"black"}
    assert "black" not in {look(label)["color"] for label in LABELS}
    system = sb.semidiscretise(sb.paper_case(10).problem, 8)
    runs = [sb.integrate(system, scheme, 1e-4, 0.05) for scheme in (sb.HHT(), sb.SDIRK(nystrom=True), sb.BDF2())]
    axis = comparison_panels("three schemes", runs, [sb.reference(system, 0.05)]).axes[0]
    curves = [line for line in axis.get_lines() if len(line.get_xdata()) > 2]
    assert [line.get_color() for line in curves] == ["black", *(look(x)["color"] for x in ("hht", "sdirk", "bdf2"))]
    assert all(np.max(np.abs(line.get_ydata())) > 0.0 for line in curves)


def test_an_observed_order_has_its_slope_constant_and_interval():
    steps = 0.1 / 2.0 ** np.arange(6)
    for slope in (0.5, 2.0, 3.0):
        order = observed_order(steps, 7.0 * steps**slope)
        assert (order.slope, order.constant) == (pytest.approx(slope, abs=1e-12), pytest.approx(7.0, rel=1e-11))
        assert order.interval < 1e-10
        assert order.points == 6
    for few in ([], [0.1], [0.1, 0.1]):
        assert np.isnan(observed_order(few, np.ones(len(few))).slope)
    two = observed_order([0.1, 0.05], [4.0, 1.0])
    assert np.isnan(two.interval)
    assert str(two) == "2.00 (two points)"
    rng, inside = np.random.default_rng(7), 0
    for _ in range(400):  # trials at 95 %: the share has the standard deviation 1.1 %, three of them are allowed
        order = observed_order(steps, 3.0 * steps**2 * np.exp(rng.normal(0.0, 0.3, len(steps))))
        inside += abs(order.slope - 2.0) <= order.interval
    assert abs(inside / 400 - 0.95) < 0.033


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_lag_and_a_decay_put_into_a_run_are_found_within_the_stated_error(noise, damping):
    """Mode j turns by late_j too slowly and decays decay_j too fast, with a ripple upon it."""
    stiffness = np.array([[500.0, -200.0], [-200.0, 300.0]])
    system = sb.System.from_matrices(np.diag([1.0, 2.0]), stiffness, damping=damping * stiffness, observe=[0.0, 1.0])
    basis, t = modes(system), np.arange(0.0, 4.0, 0.005)
    late, decay, own = np.array([0.11, -0.3]), np.array([0.02, 0.3]), 0.5 * basis.damping
    turning = np.sqrt(basis.omega**2 - own**2)
    z = np.exp(np.outer(t, -(own + decay) + 1j * (turning - late)))
    z = z * (1.0 + noise * np.cos(37.0 * t)[:, None]) * (1.0 + noise * 1j * np.sin(41.0 * t)[:, None])
    c = z.imag / turning  # z = c' - conj(lambda) c with lambda = -own + i turning
    q, v = (x @ basis.shapes.T for x in (c, z.real - own * c))
    found = free_mode_errors(Trajectory(
        t=t, tip=q[:, -1], tip_velocity=v[:, -1], contacts=(), work=Work(), provenance={"dt": 0.005}, system=system,
        pieces=lambda: iter([(t, q, v, np.zeros((len(t), 0)))]),
    ))  # fmt: skip
    elongation = turning / (turning - late) - 1.0
    ratio = (own + decay) / np.hypot(own + decay, turning - late)
    assert np.all(np.abs(found.period_elongation - elongation) <= found.elongation_error + 1e-12)
    assert np.all(np.abs(found.damping_ratio - ratio) <= found.damping_error + 1e-12)
    assert np.all(found.elongation_error < (1e-10 if noise == 0.0 else 0.1 * np.abs(elongation)))
    with pytest.raises(sb.InputError, match="free"):
        free_mode_errors(sb.integrate(sb.semidiscretise(PLAIN, 6), sb.HHT(), 1e-3, 0.1))


@pytest.mark.parametrize(
    ("units", "quantity", "name"),
    [((), "energy", ""), (("m", "s", "N"), "energy", "J"), (("m", "s", "N"), "mass per length", "kg/m"),
     (("mm", "s", "N"), "energy", "N mm"), (("rad", "s", "N m"), "stop stiffness", "N m/rad"),
     (("mm", "ms", "kN"), "velocity", "mm/ms"), (("mm", "s", "N"), "mass per length", "N s²/mm²")],
)  # fmt: skip
def test_derived_units_follow_from_three(units, quantity, name):
    assert unit_of(units, quantity) == name


@pytest.mark.parametrize(
    ("call", "words"),
    [*((lambda units=units: sb.BeamProblem(stiffness=1.0, units=units), "units must be the names")
       for units in (("m", "", "N"), ("m", "s"), ("m", "s", 1), "mm", 1, ("m", "s", "\x1b[2J"))),
     (lambda: sb.integrate(sb.semidiscretise(STEEL, 8), sb.HHT(), 1e-4, 0.01).displacement(0.5),
      r"x must lie in \[0, 0\.4\]")],
)  # fmt: skip
def test_units_and_places_that_are_none(call, words):
    with pytest.raises(sb.InputError, match=words):
        call()


def test_the_same_numbers_in_other_units_are_another_system():
    """Else a cache would give back a reference in millimetres for one in metres."""
    numbers = {"length": 1.0, "bending_stiffness": 300.0, "mass_per_length": 1.0}
    millimetres = sb.BeamProblem.from_physical(**numbers, units=("mm", "s", "N"))
    problems = [sb.BeamProblem(stiffness=300.0), sb.BeamProblem.from_physical(**numbers), millimetres]
    assert len({sb.semidiscretise(problem, 8).fingerprint for problem in problems}) == 3
