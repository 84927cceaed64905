"""The paper's panels for any case: every curve against values computed without the figure."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.figures.chart import log_scale, new_figure

CASE = replace(sb.paper_case(10), t_end=1.5)
TITLES = (
    "displacement",
    "phase portrait",
    "the first contacts",
    r"contact force $\sigma$",
    "delayed portrait",
    "spectrum",
)


def curves(axis) -> dict[str, np.ndarray]:
    return {line.get_label(): line.get_xydata() for line in axis.lines if not line.get_label().startswith("_")}


def test_every_panel_of_a_case_holds_what_its_runs_hold():
    figure = sb.paper_figure(CASE)
    head = " ".join(figure.get_suptitle().split())
    assert head.startswith("table10: exact, HHT(alpha=-0.1), SDIRK")
    assert head.endswith("t = 0 to 1.5")
    assert tuple(axis.get_title(loc="left").partition(") ")[2] for axis in figure.axes) == TITLES
    displacement, portrait, contact, shear, delayed, spectrum = map(curves, figure.axes)
    scheme, form = CASE.runs[0]
    run = sb.integrate(CASE.system(form), scheme, CASE.dt, CASE.t_end)
    exact = sb.reference(CASE.system(form), CASE.t_end)
    label = next(name for name in displacement if name.startswith("HHT"))
    np.testing.assert_array_equal(displacement[label], np.stack([run.t, run.tip], 1))
    np.testing.assert_array_equal(portrait[label], np.stack([run.tip, run.tip_velocity], 1))
    t, sigma = shear[label].T
    wanted = -5e6 * (np.maximum(run.tip - 0.1, 0.0) - np.maximum(-0.1 - run.tip, 0.0))
    np.testing.assert_allclose(sigma, wanted, rtol=1e-12, atol=0.0)
    for name in ("exact", "exact, one realisation"):  # which it is past its horizon
        t, u = displacement[name].T
        np.testing.assert_allclose(u, exact.at(t)[0], atol=1e-12)
        assert np.all(t <= exact.horizon) if name == "exact" else np.all(t > exact.horizon)
    motions = {"exact, one realisation": lambda t: exact.at(t)[0], label: lambda t: np.interp(t, run.t, run.tip)}
    for name, path in motions.items():
        now, later = delayed[name].T
        t = np.linspace(0.0, 1.5 - 0.2 * np.pi, len(now))
        np.testing.assert_allclose(now, path(t), atol=1e-12)
        np.testing.assert_allclose(later, path(t + 0.2 * np.pi), atol=1e-12)
    first = exact.impacts.times[0]
    assert contact["exact"][0, 0] < first < contact["exact"][-1, 0] < 0.1
    at, amplitude = spectrum[label].T
    period = round(0.4 * np.pi / CASE.dt)  # two periods of the drive fit
    np.testing.assert_allclose(at[1], 10.0, rtol=1e-3)
    wave = run.tip[-period:] * np.exp(-2j * np.pi * 2 * np.arange(period) / period)
    np.testing.assert_allclose(amplitude[1], 2 * abs(np.mean(wave)), rtol=1e-6)


def test_panels_by_name_for_systems_without_drive_or_stops():
    free = sb.System.from_matrices([[1.0]], [[4.0]], observe=[1.0], initial_velocity=[1.0])
    run = sb.integrate(free, sb.Trapezoidal(), 0.01, 3.0)
    whole = sb.paper_figure(run)
    assert len(whole.axes) == 3
    assert whole.get_suptitle().startswith("Trapezoidal, t = 0 to 3")
    assert len(sb.paper_figure([run], ["portrait"], (1.0, 2.0)).axes) == 1
    for name in ("contact", "delayed", "shears"):
        with pytest.raises(sb.InputError, match="panels"):
            sb.paper_figure(run, [name])
    with pytest.raises(sb.InputError, match="span"):
        sb.paper_figure(run, span=(0.0, 4.0))
    with pytest.raises(sb.InputError, match="system"):
        sb.paper_figure(sb.Trajectory.from_arrays([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]))


def test_a_close_up_names_what_its_axis_shows():
    """The tip where the contact is the tip's, else the position at the contact."""
    stops = [sb.Stops(upper=0.05, stiffness=1e5, position=0.5), sb.Stops(upper=0.1, stiffness=1e5)]
    beam = sb.BeamProblem(stiffness=300.0, stops=stops, base=sb.Harmonic(amplitude=0.2, frequency=10.0))
    run = sb.integrate(sb.semidiscretise(beam, 8), sb.HHT(), dt=1e-4, t_end=0.1)
    labels = [axis.get_ylabel() for axis in sb.paper_figure(run, ["contact"]).axes]
    assert labels == ["position at contact 1", "tip displacement $u(1, t)$"]


@pytest.mark.parametrize(("ends", "shown"), [((1.2e-6, 2e-5), 2), ((2.0, 9.0), 2), ((1e-6, 1e-2), 4)])
def test_numbers_of_a_logarithmic_axis_stand_apart(ends, shown):
    """Between one and two decades too, where all nine lines of a decade would be numbered."""
    figure = new_figure(4.0)
    axis = figure.subplots(1, 2)[1]
    axis.plot(ends, (1.0, 2.0))
    log_scale(axis, y=False)
    figure.draw_without_rendering()
    boxes = [x.get_window_extent() for x in axis.get_xticklabels(which="both") if x.get_text()]
    inside = sorted((box.x0, box.x1) for box in boxes if axis.bbox.x0 <= 0.5 * (box.x0 + box.x1) <= axis.bbox.x1)
    assert len(inside) >= shown
    assert all(right < left for (_, right), (left, _) in pairwise(inside))
