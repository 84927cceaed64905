"""The commands of the studies: what they refuse, and what they leave as it was."""

from __future__ import annotations

import inspect
import json
import re

import pytest

from stiffbeam.cli.application import command_of
from stiffbeam.studies import STUDIES, find_study


def test_a_study_that_finds_nothing_ends_with_1_and_overwrites_nothing(command, tmp_path):
    """The printed stage matrix is refused at this step, and no other scheme is asked for."""
    earlier = tmp_path / "modes.json"
    earlier.write_text("what an earlier run has found", encoding="utf-8")
    code, out, _ = command("modes", "table10", "--schemes", "SDIRK.printed(stage-matrix)", "--out", ".", "--jobs", "1")
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


RECORD = """
[[case]]
name = "short"
dt = 1e-3
t_end = 2.0
[case.system]
mass = [[1.0]]
stiffness = [[10.0]]
loads = [{ row = [1.0], sampled = { t = [0.0, 0.5, 1.0], values = [0.0, 5.0, 0.0] } }]
contacts = [{ row = [1.0], upper = 0.1, stiffness = 1e3 }]
"""


@pytest.mark.parametrize(
    "words",
    [["ensemble", "--members", "3"], ["impacts"], ["rigid"], ["energy"], ["converge"], ["precision"],
     ["sweep", "--parameter", "contacts[0].stops.stiffness", "--values", "1e3:2e3:3"]],
)  # fmt: skip
def test_a_record_shorter_than_the_run_is_bad_input_of_every_study(words, command, tmp_path):
    (tmp_path / "short.toml").write_text(RECORD, encoding="utf-8")
    code, out, err = command(words[0], "short.toml", *words[1:])
    assert code == 2
    assert out == ""
    assert "within its samples, [0, 1], got 't = 2'" in err


def test_a_quantity_that_is_named_twice_is_refused(command):
    for words in (["advise", "table10", "--want", "tip=1e-3,tip=1e-2"],
                  ["doubt", "table10", "--uncertain", "stiffness=1:2,stiffness=2:3"]):  # fmt: skip
        code, _, err = command(*words)
        assert code == 2
        assert "once" in err


@pytest.mark.parametrize("name", STUDIES)
def test_a_command_has_the_options_of_its_study_with_help_and_defaults(name):
    study = find_study(name)
    made = {parameter.name: parameter for parameter in command_of(name).params}
    own = [p for p in inspect.signature(study.points).parameters.values() if p.name != "case"]
    around = {"out", "json_file", "smoke"} | (set() if study.measured else {"jobs", "scheduler"})
    assert set(made) == {"case", *around, *(p.name for p in own)}
    for option in own:
        assert made[option.name].opts == [f"--{option.name.replace('_', '-')}"]
        assert made[option.name].default is None  # what is not given is left to the study and its smoke options
        words = made[option.name].help
        assert words, option.name
        if option.default is option.empty:
            assert "the case's" in words
        elif option.default is not None and not isinstance(option.default, bool):
            assert words.endswith(f"default: {option.default}")


@pytest.mark.slow
def test_options_reach_the_study_as_what_they_are(command, tmp_path):
    arguments = ["--schemes", "HHT(alpha=-0.1),bdf2", "--kinds", "smooth", "--halvings", "2", "--dt", "2e-3"]
    code, out, _ = command("converge", "table10", *arguments, "--out", "here", "--jobs", "1", "--json", "-")
    records = json.loads(out)
    assert code == 0
    options = {"schemes": ["HHT(alpha=-0.1)", "BDF2"], "kinds": ["smooth"], "halvings": 2, "dt": 2e-3}
    assert records["options"] == options
    assert {(row["scheme"], row["kind"]) for row in records["rows"]} == {
        ("HHT(alpha=-0.1)", "smooth"),
        ("BDF2", "smooth"),
    }
    assert (tmp_path / "here" / "converge.png").is_file()


@pytest.mark.slow
def test_numbers_in_a_list_are_read_or_refused(command):
    code, out, _ = command(
        "space", "table10", "--cells", "6,8,10", "--forms", "displacement", "--finest", "12", "--json", "-"
    )
    assert code == 0
    assert {row["cells"] for row in json.loads(out)["rows"]} == {6, 8, 10}
    code, _, err = command("space", "table10", "--cells", "6,eight")
    assert (code, "numbers with commas between them" in err) == (2, True)
    code, _, err = command("rigid", "table10", "--factors", "1:2")
    assert (code, "numbers with commas between them" in err) == (2, True)


@pytest.mark.parametrize("name", STUDIES)
def test_the_help_of_a_study_names_its_parameters_as_options(name):
    """``starts`` pairs a distance ``size`` apart: the words alone would be read as a sentence."""
    study = find_study(name)
    told, options = command_of(name).help, inspect.signature(study.points).parameters
    assert "``" not in told
    for word in re.findall(r"``(\w+)``", study.points.__doc__):
        assert (f"--{word.replace('_', '-')}" if word in options else f"'{word}'") in told
