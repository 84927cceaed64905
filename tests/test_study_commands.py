"""The commands of the studies: what they refuse, and what they leave as it was."""

from __future__ import annotations

import pytest


def test_a_study_that_finds_nothing_ends_with_1_and_overwrites_nothing(command, tmp_path):
    """The printed stage matrix is refused at this step, and no other scheme is asked for."""
    earlier = tmp_path / "modes.json"
    earlier.write_text("what an earlier run has found", encoding="utf-8")
    code, out, _ = command("modes", "table10", "--schemes", "sdirk.printed(stage-matrix)", "--out", ".", "--jobs", "1")
    assert code == 1
    assert "No point could be evaluated" in " ".join(out.split())
    assert "Written: nothing" in " ".join(out.split())
    assert earlier.read_text(encoding="utf-8") == "what an earlier run has found"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["ensemble", "table10", "--members", "0"], "members"), (["modes", "table10", "--dt", "0"], "dt"),
        (["converge", "table10", "--dt", "nan"], "dt"), (["chaos", "table10", "--starts", "0"], "starts"),
        (["precision", "table10", "--methods", "exakt"], "exact"),
        (["reference", "table10", "--method", "all", "--out", "x.nc"], "--out"),
        (["modes", "table10", "--smoke", "--json", "/proc/none/x.json"], "--json"),
    ],
)  # fmt: skip
def test_bad_options_of_studies_are_refused_before_anything_is_written(arguments, said, command, tmp_path):
    code, _, err = command(*arguments)
    assert code == 2
    assert said in err
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
