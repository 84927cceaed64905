"""Objects show themselves in one screen, draw themselves, and come back whole from files."""

from __future__ import annotations

import numpy as np
import pytest
import xarray
from systems import bouncing_chain

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.studies.comparison import compare_case

SCREEN = 24 * 80  # characters


@pytest.fixture(scope="module")
def things(table10):
    system = sb.semidiscretise(table10, 25)
    run, reference = sb.integrate(system, sb.HHT(), 1e-4, 0.1), sb.reference(system, 0.1)
    members = sb.perturbed_members(system, 8)
    return {
        "case": sb.paper_case(10), "system": system, "run": run, "reference": reference, "members": members,
        "comparison": sb.compare(run, reference), "ledger": run.energy, "contact": system.contacts[0],
        "many": sb.integrate_ensemble(system, sb.HHT(), 1e-4, 0.1, members, every=100), "modes": sb.modes(system),
        "origin": system.origin, "problem": table10,
        "growth": sb.lyapunov(system, 0.1), "amplification": sb.amplification(sb.HHT(), np.linspace(0.01, 1.0, 500)),
        "solution": reference.solution, "records": sb.study("modes", schemes=["bdf2"], steps=100),
    }  # fmt: skip


def test_nothing_shows_more_than_a_screen(things):
    for name, thing in things.items():
        text = repr(thing)
        assert len(text) <= SCREEN, name
        assert len(text.splitlines()) <= 26, name


def test_a_comparison_shows_its_table_once_in_a_notebook(things):
    html = things["comparison"]._repr_html_()
    assert html.count("<table") == html.count("</table>") == 2  # the numbers, and one line for each contact
    assert "<pre" not in html
    assert isinstance(str(things["comparison"]), str)


def test_a_run_draws_itself(things):
    """Every panel has what its label says: the curves are the run's own arrays."""
    for name in ("run", "reference"):
        run = things[name]
        figure = run.plot()
        tip, force, portrait, energy = figure.axes
        np.testing.assert_array_equal(tip.lines[0].get_ydata(), run.tip)
        np.testing.assert_array_equal(portrait.lines[0].get_xdata(), run.tip)
        np.testing.assert_array_equal(force.lines[0].get_ydata(), run.contact_force)
        labels = [line.get_label() for line in energy.lines]
        assert {"kinetic", "loss"} <= set(labels)
        assert all(axis.get_xlabel() and axis.get_ylabel() for axis in figure.axes)
    assert sb.integrate(bouncing_chain(), sb.BDF2(), 1e-2, 1.0).plot().axes


def test_a_comparison_draws_its_pair(things):
    comparison = things["comparison"]
    assert len(comparison.figure().axes) == 4
    assert "pair" not in comparison.to_dict()
    assert not [name for name in comparison.to_dataframe() if "pair" in name]


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [sb.HHT(alpha=-0.1), sb.SDIRK(nystrom=True)])
def test_a_loaded_run_has_its_field_with_its_system(things, tmp_path, scheme):
    """To the bit: states are made again by the same march; and not without the system."""
    system = things["system"]
    run = sb.integrate(system, scheme, 1e-4, 0.1, every=10)
    back = sb.load(run.save(tmp_path / "run.nc"), system)
    np.testing.assert_array_equal(back.displacement(0.37), run.displacement(0.37))
    np.testing.assert_array_equal(back.moment(0.0), run.moment(0.0))
    with pytest.raises(InputError, match=r"sb.load\(file, system\)"):
        sb.load(tmp_path / "run.nc").displacement(0.5)


def test_a_loaded_exact_solution_has_its_field(things, tmp_path):
    reference = things["reference"]
    back = sb.load(reference.save(tmp_path / "exact.nc"), things["system"])
    np.testing.assert_array_equal(back.displacement(0.37), reference.displacement(0.37))


def test_a_loaded_run_of_coupled_modes_has_its_field(tmp_path):
    system = bouncing_chain(damping=np.diag([0.5, 0.0, 0.2]))  # does not decouple
    run = sb.integrate(system, sb.BDF2(), 1e-2, 1.0)
    back = sb.load(run.save(tmp_path / "dense.nc"), system)
    np.testing.assert_array_equal(back.states[0], run.states[0])


def test_an_ensemble_is_saved_whole(things, tmp_path):
    many = things["many"]
    with xarray.open_dataset(many.save(tmp_path / "many.nc"), engine="h5netcdf", decode_times=False) as found:
        np.testing.assert_array_equal(found.tip, many.tip)
        np.testing.assert_array_equal(found.impact_count[0], many.impact_count)
        np.testing.assert_array_equal(found.contact_peak_force[0], many.peak_force)
        third = found.impact_time[(found.impact_member == 3) & (found.impact_contact == 0)]
        np.testing.assert_array_equal(third, many.contacts[0].impacts_of(3).times)
        assert found.tip.attrs["long_name"]
    assert many.save(tmp_path / "many.csv").read_text().count("\n") == 9
    with pytest.raises(InputError, match=r"end in \.nc or "):
        many.save(tmp_path / "many.xlsx")


def test_a_comparison_of_a_case_shows_itself():
    case = sb.paper_case(10)
    assert "table10" in repr(compare_case(case, case.runs[:1], ("exact",), dt=1e-3, t_end=0.05))
