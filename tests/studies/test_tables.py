"""The paper's seventeen tables as cases."""

from __future__ import annotations

import stiffbeam as sb
from stiffbeam.files.cases import load_cases, paper_cases, paper_text
from stiffbeam.schemes import GAMMA_THIRD_ORDER
from stiffbeam.schemes.labels import parse_run


def test_all_seventeen_tables_load_in_order():
    cases = paper_cases()
    assert list(cases) == [f"table{k}" for k in range(1, 18)]
    for case in cases.values():
        assert case.title
        assert case.runs
        assert case.cells in (25, 40, 50)
        assert abs(round(case.t_end / case.dt) * case.dt - case.t_end) < 1e-9 * case.t_end


def test_every_published_number_is_of_a_run_the_case_makes():
    def key(scheme, form):
        return type(scheme), tuple(scheme.parameters.items()), form

    for case in paper_cases().values():
        runs = {key(*run) for run in case.runs}
        for numbers in case.published.values():
            assert {key(*parse_run(name)) for name in numbers} <= runs
            assert all(value > 0 for value in numbers.values())


def test_what_is_inferred_is_noted_with_its_reason():
    for case in paper_cases().values():
        noted = {note.partition(":")[0] for note in case.notes}
        assert {"initial data", "t_end"} <= noted
        assert all(note.partition(":")[2].strip() for note in case.notes)
        third = [s for s, _ in case.runs if isinstance(s, sb.SDIRK) and s.gamma == GAMMA_THIRD_ORDER]
        assert bool(third) == ("scheme" in noted)
        assert bool(case.problem.loads) == ("load" in noted)
    assert any(note.startswith("dt: printed 25 x 10^-5") for note in sb.paper_case(11).notes)


def test_the_papers_file_is_one_that_users_can_load(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(paper_text(), encoding="utf-8")
    mine = load_cases(file)
    assert list(mine) == list(paper_cases())
    for name, case in paper_cases().items():
        assert mine[name].problem == case.problem
        assert str(mine[name].runs) == str(case.runs)
