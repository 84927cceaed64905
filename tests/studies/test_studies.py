"""The contract of a study: its points, its files, its table; and the textbook values of the studies of the package."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from systems import bouncing_chain, one_mass

import stiffbeam as sb
from stiffbeam.measures.report import Report
from stiffbeam.studies import STUDIES, Answer, Study, chaos, option, studies
from stiffbeam.studies.base import NOTHING
from stiffbeam.studies.converge import orders

SPRING = one_mass(100.0, sb.Stops(upper=0.05, stiffness=1e4), load=sb.Harmonic(8.0, 5.0))
SPAN = {"dt": 2e-3, "t_end": 1.0}
CALLS: list[float] = []


@dataclass(frozen=True, kw_only=True)
class Doubled(Study):
    """What is twice each number?"""

    numbers: tuple[float, ...] = option((1.0, 2.0, 0.0), "numbers")
    labels: ClassVar = {"number": ("number", "length"), "twice": ("twice the number", "length")}

    def points(self, case):
        return [{"number": x} for x in self.numbers]

    def run(self, case, number):
        CALLS.append(number)
        if not number:
            raise sb.InputError("number", number, "not be 0", "take another")
        return {"twice": 2.0 * number, "exact": 0.1 + 0.2}

    def answer(self, table, case):
        return Answer(f"The largest is {table.twice.max():g}.", table[["number", "twice"]])

    def draw(self, table, figure, case):
        axis = figure.subplots()
        axis.plot(table.number, table.twice)
        axis.set(xlabel=table.attrs["labels"]["number"], ylabel=table.attrs["labels"]["twice"])


def doubled(**options):
    CALLS.clear()
    return sb.study("doubled", SPRING, **SPAN, **options)


def test_a_subclass_is_a_study_with_its_options_table_answer_and_picture():
    records = doubled(numbers=[1.0, 3.0])
    assert "doubled" in STUDIES
    assert records.table.twice.tolist() == [2.0, 6.0]
    assert records.table.attrs["labels"] == {"number": "number", "twice": "twice the number"}
    assert records.answer.verdict == "The largest is 6."
    assert str(records).splitlines()[:2] == ["What is twice each number?", "The largest is 6."]
    assert records.figure().axes[0].get_xlabel() == "number"
    with pytest.raises(sb.InputError, match="did you mean numbers"):
        doubled(number=[1.0])
    with pytest.raises(sb.InputError, match="be a study"):
        sb.study("doubles", SPRING, **SPAN)


def test_a_point_without_a_result_is_a_row_with_its_reason():
    records = doubled()
    assert list(records.lost.values()) == [1]
    assert "not be 0" in next(iter(records.lost))
    assert len(records.found) == 2
    assert "lost (1): number must not be 0" in str(records)
    nothing = doubled(numbers=[0.0])
    assert nothing.answer.verdict == NOTHING
    assert nothing.figure().axes


def test_finished_points_are_files_that_a_second_run_reads_to_the_bit(tmp_path):
    first = doubled(folder=tmp_path)
    assert sorted(CALLS) == [0.0, 1.0, 2.0]
    again = doubled(folder=tmp_path)
    assert CALLS == [0.0]  # what was refused may work now
    pd.testing.assert_frame_equal(first.table, again.table)
    assert len(list(tmp_path.iterdir())) == 2
    doubled(folder=tmp_path, numbers=[1.0])
    assert CALLS == [1.0]  # other options are another study
    for file in tmp_path.iterdir():
        file.write_text("cut")
    assert doubled(folder=tmp_path).table.equals(first.table)


def test_records_are_saved_and_are_json(tmp_path):
    records = doubled()
    csv, text, picture = records.save(tmp_path)
    assert pd.read_csv(csv).twice.dropna().tolist() == [2.0, 4.0]
    assert "The largest is 4." in text.read_text()
    assert picture.stat().st_size > 10_000
    found = json.loads(json.dumps(records.to_dict(), allow_nan=False))
    assert (found["study"], found["answer"], len(found["rows"])) == ("doubled", "The largest is 4.", 3)


def test_a_table_wider_than_the_terminal_stands_in_parts_that_begin_with_its_first_column():
    text = Report([], [("", pd.DataFrame({"name": ["x"], "one": [1.0], "two": [2.0]}))]).text(9)
    lines = [line.split() for line in text.splitlines()]
    assert lines == [["name", "one", "\\"], ["x", "1.0"], [], ["name", "two"], ["x", "2.0"]]


def test_work_that_a_function_does_not_count_is_not_compared():
    def solve(system, dt, t_end):
        t = dt * np.arange(round(t_end / dt) + 1)
        return t, system.q0[0] * np.cos(10.0 * t) + 0.1 * system.v0[0] * np.sin(10.0 * t)

    options = SPAN | {"halvings": 2, "kinds": "smooth"}
    found = sb.study("converge", one_mass(100.0, v=1.0), integrators=["BDF2", solve], **options)
    assert found.found.groupby("integrator").solves.count().to_list() == [2, 0]
    assert "(BDF2)" in found.answer.verdict.partition("Least work")[2]
    alone = sb.study("converge", one_mass(100.0, v=1.0), integrators=[solve], **options)
    assert "Least work" not in alone.answer.verdict
    assert alone.figure().axes


SCRIPT = """
import stiffbeam as sb
class Mine(sb.BDF2):
    pass
system = sb.System.from_matrices([[1.0]], [[100.0]], initial_velocity=[1.0], observe=[1.0])
options = {"dt": 1e-2, "t_end": 1.0, "steps": 100, "schemes": ["HHT(alpha=-0.1)", Mine(), "BDF2"]}
here, there = (sb.study("modes", system, jobs=jobs, **options) for jobs in (1, 2))
there.figure()
print("ONCE", there.table["scheme"].tolist(), there.lost, there.table.equals(here.table))
"""


@pytest.mark.slow
def test_a_script_without_a_guard_runs_its_study_in_processes(tmp_path):
    """With a scheme of its own, to the same rows as in one."""
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "ONCE ['HHT(alpha=-0.1)', 'Mine', 'BDF2'] {} True\n"


def test_every_study_of_the_package_has_a_question_and_help_for_its_options():
    assert {"chaos", "converge", "energy", "ensemble", "modes", "orbits", "rigid", "space", "sweep"} <= set(studies())
    for kind in studies().values():
        assert kind.question().endswith("?")
        for each in fields(kind):
            assert each.metadata["help"], (kind, each.name)


# ---------------------------------------------------------------- textbook values


def test_orders_of_schemes_without_contact():
    system = one_mass(1.0, load=sb.Harmonic(1.0, 0.6))
    schemes = ["BDF2", "SDIRK(gamma=0.4359)", "HHT(alpha=-0.1)", "cvode"]
    records = sb.study("converge", system, dt=0.1, t_end=20.0, integrators=schemes, halvings=5, tolerances=[1e-6])
    found = {label.partition("(")[0]: order.slope for (_, label), order in orders(records.found).items()}
    assert found.pop("SDIRK") == pytest.approx(3.0, abs=0.1)
    assert all(slope == pytest.approx(2.0, abs=0.1) for slope in found.values())
    solver = records.found[records.found.integrator == "cvode"]
    assert solver.tip_error.iloc[0] < 1e-4
    assert "cvode" not in found


@pytest.mark.slow
def test_impacts_are_right_at_small_steps_and_errors_fall():
    views = ["order", "work", "impacts", "matched"]
    options = {"integrators": ["SDIRK(gamma=0.4359)", "Trapezoidal()"], "halvings": 6, "views": views}
    records = sb.study("converge", SPRING, **SPAN, **options, impacts=2)
    table = records.found[records.found.kind == "contact"]
    finest = table.sort_values("dt").groupby("integrator").first()
    assert (finest.impacts == finest.exact_impacts).all()
    assert (finest.tip_error < 1e-4).all()
    assert records.figure().axes


def test_durations_of_contacts_are_those_of_the_spring():
    """A mass thrown at a spring stays for half a period of it."""
    system = one_mass(0.0, sb.Stops(upper=0.1, stiffness=400.0), v=1.0)
    records = sb.study("ensemble", system, dt=1e-3, t_end=0.5, schemes=["Trapezoidal()"], members=3)
    median = records.table[records.table.kind == "summary"].set_index("method")["median"]
    assert median["exact"] == pytest.approx(np.pi / 20.0, rel=1e-9)
    assert median["Trapezoidal"] == pytest.approx(np.pi / 20.0, rel=1e-3)


def test_the_modes_of_a_run_are_those_of_one_step():
    records = sb.study("modes", bouncing_chain(), **SPAN, schemes=["BDF2", "HHT(alpha=-0.1)"], steps=4000)
    table = records.found
    assert np.nanmax(np.abs(table.period_elongation - table.period_elongation_theory)) < 1e-5
    trapezoid = sb.study("modes", one_mass(1.0, v=1.0), dt=0.1, t_end=1.0, schemes=["Trapezoidal()"], steps=400).found
    x = 0.1 / 2.0
    assert trapezoid.period_elongation.iloc[0] == pytest.approx(x / np.arctan(x) - 1.0, rel=1e-6)


def test_the_energy_balance_of_the_exact_flow_closes():
    records = sb.study("energy", SPRING, **SPAN, schemes=["BDF2", "Trapezoidal()"])
    last = records.found.groupby("scheme").last()
    assert abs(last.lost_fraction["exact"]) < 1e-10
    assert last.lost_fraction["BDF2"] > 1e-3


@pytest.mark.slow
def test_grids_converge_with_the_second_order():
    from stiffbeam.studies.space import orders as in_space

    records = sb.study("space", "table10", t_end=0.2, cells=[10, 20, 40], finest=60, forms=["displacement"])
    assert in_space(records.found)["tip response", "displacement"].slope == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_stiff_stops_approach_rigid_ones_with_the_square_root(damping):
    system = one_mass(100.0, sb.Stops(upper=0.05, stiffness=1e6), damping=damping, load=sb.Harmonic(8.0, 5.0))
    records = sb.study("rigid", system, dt=1e-3, t_end=3.0, impacts=1, factors=[1.0, 16.0, 256.0, 4096.0])
    rows = records.found.sort_values("kappa")
    slope = np.polyfit(np.log(rows.kappa), np.log(rows.tip_error), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.05)


def test_a_point_file_that_is_a_link_is_neither_read_nor_followed(tmp_path):
    doubled(folder=tmp_path / "points", numbers=[1.0])
    (file,) = (tmp_path / "points").iterdir()
    stranger = tmp_path / "stranger"
    stranger.write_text('[{"twice": 99.0}]')
    file.unlink()
    file.symlink_to(stranger)
    assert doubled(folder=tmp_path / "points", numbers=[1.0]).table.twice.tolist() == [2.0]
    assert stranger.read_text() == '[{"twice": 99.0}]'
    assert not file.is_symlink()


def test_a_point_file_names_no_code(tmp_path):
    doubled(folder=tmp_path, numbers=[1.0])
    (file,) = tmp_path.iterdir()
    file.write_text(json.dumps([{"scheme": "antigravity:Scheme", "twice": 1.0, "number": 1.0, "exact": 0.0}]))
    assert doubled(folder=tmp_path, numbers=[1.0]).table.scheme.tolist() == ["antigravity:Scheme"]
    assert "antigravity" not in sys.modules


# ---------------------------------------------------------------- divergence of neighbours, energy lost


def test_a_load_that_takes_its_work_back_makes_no_loss_of_any_size():
    """-2e5 % was said to be lost of all energy: at that moment the load had taken back what it had put in."""
    system = one_mass(100.0, sb.Stops(upper=0.05, stiffness=1e4), load=sb.Harmonic(8.0, 5.0))
    ledger = sb.integrate(system, sb.Trapezoidal(), 2e-3, 14.594).energy
    most = np.max(ledger.input)
    assert ledger.input[-1] < 1e-3 * most
    assert ledger.lost_fraction() == pytest.approx(ledger.loss[-1] / most, rel=1e-6)
    assert -0.05 < ledger.lost_fraction() < 0.0
    assert ledger.supplied == pytest.approx([np.max(ledger.input[: k + 1]) for k in range(len(ledger.t))])


def test_chaos_fits_no_distances_that_are_rounding():
    """Neighbours of q'' + 2 q' + 25 q = sin t converge with the exponent -1, and soon differ by rounding only."""
    system = one_mass(25.0, sb.Stops(upper=1e3, stiffness=1e3), damping=2.0, load=sb.Harmonic(1.0, 1.0), q=1.0)
    found = sb.study("chaos", system, dt=1e-2, t_end=60.0, span=25.0, starts=12, schemes=["trapezoidal", "bdf2"])
    exponents = [
        row["exponent"]
        for row in found.table.to_dict("records")
        if row["pair"] == row["pair"] and row["exponent"] == row["exponent"]
    ]
    assert len(exponents) >= 36
    assert np.mean(exponents) == pytest.approx(-1.0, abs=0.05)


def one(stiffness, restitution=None, speed=0.0, start=0.0):
    """u'' + u = 0 below a stop at 0.3: no motion of it is chaotic."""
    stop = sb.Stops(upper=0.3, stiffness=stiffness, restitution=restitution)
    return one_mass(1.0, stop, q=start, v=speed)


PAIR = sb.System.from_matrices(
    np.eye(2), [[1.0, -1.0], [-1.0, 1.0]], observe=[1.0, 0.0], initial_displacement=[1.0, 0.2]
)
BALL = one_mass(0.0, sb.Stops(lower=0.0, upper=2.0, stiffness=np.inf, restitution=1.0), q=1.0, v=-1.0)


@pytest.mark.parametrize(
    ("system", "t_end", "scheme"),
    [
        (PAIR, 5.0, "Trapezoidal"),  # two free masses drift apart like t
        (PAIR, 500.0, "Trapezoidal"),
        (one(100.0, speed=1.0), 50.0, "Trapezoidal"),  # its period hangs on its energy: like t
        (one(100.0, speed=1.0), 200.0, "Trapezoidal"),
        pytest.param(one(np.inf, 1.0, start=-1.0), 50.0, "MoreauJean", marks=pytest.mark.slow),
        (one(np.inf, 0.0, start=-1.0), 50.0, "MoreauJean"),  # parts once, where one grazes
        pytest.param(BALL, 50.0, "MoreauJean", marks=pytest.mark.campaign),
    ],
)
def test_neighbours_that_part_like_a_power_of_time_have_no_exponent(system, t_end, scheme):
    found = sb.study("chaos", system, dt=t_end / 20000, t_end=t_end, schemes=[scheme], jobs=1)
    methods = {row["method"] for row in found.table.to_dict("records")}
    assert methods == {"exact", next(m for m in methods if m.startswith(scheme))}
    assert set(chaos.exponents(found.table).values()) == {None}
    assert found.answer.verdict.startswith("No exponential change of the distance is seen for exact, ")


def test_a_short_blow_perturbs_by_the_motion_it_makes():
    """An impulse of 4e-3 in 2e-5 on a unit mass: its speed is 4e-3, not 400 over a radian."""
    blow = sb.Sampled([0.0, 1e-5, 2e-5, 9.0], [0.0, 400.0, 0.0, 0.0], "linear")
    system = one_mass(100.0, sb.Stops(upper=1.0, stiffness=1e3), load=blow)
    members = sb.perturbed_members(system, 200)
    speeds = np.array([member.v0[0] for member in members])
    assert 0.9e-3 * 4e-3 < np.max(np.abs(speeds)) <= 1e-3 * 4e-3
