"""Rows in columns are the rows: value by value, type by type, through the journal, in answers and pictures."""

from __future__ import annotations

import json
import pickle
import sys
from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.studies import runner
from stiffbeam.studies.interface import Batch, Column, Selection, Table
from stiffbeam.studies.runner import Journal

FLOATS = np.random.default_rng(3).normal(size=500).tolist()


def alike(a, b) -> bool:
    """Equal with their types, signs of zero and NaN, and in the same order of names."""
    return repr(a) == repr(b)


@pytest.mark.parametrize(
    "values",
    [
        FLOATS,
        [0.0, -0.0, float("nan"), float("inf"), -float("inf"), 5e-324] * 30,
        [1.0, 1, True, None, "1", [1, 2.5, "x"], [], {"a": None}],
        [False, True, False],
        list(range(300)),
        [-1, 2**40, 7],
        [0, 2**63 - 1],
        [2**70, -3],
        ["a", "b"] * 100,
        [None] * 9,
        [0.1],
    ],
    ids=str,
)
def test_a_column_returns_its_values_also_from_json(values):
    column = Column.of(values)
    assert alike(list(column), values)
    text = json.dumps(column.to_json())
    assert alike(list(Column.from_json(json.loads(text), len(values))), values)
    with pytest.raises(ValueError, match="values for"):
        Column.from_json(Column.of(FLOATS).to_json(), 499)


def rows_of_two_kinds():
    rows = []
    for i, x in enumerate(FLOATS[:100]):
        rows.append({"kind": "contact", "x": x, "n": i, "peak": None if i % 7 else 2.0 * x})
        rows += [{"kind": "section", "x": x, "period": k, "tip": FLOATS[i + k]} for k in range(i % 4)]
    return [*rows, {"refused": "no"}]


def test_a_batch_returns_its_rows_also_from_json():
    rows = rows_of_two_kinds()
    batch = Batch.of(rows)
    assert alike(list(batch), rows)
    assert alike(list(Batch.from_json(json.loads(json.dumps(batch.to_json())))), rows)
    assert alike(list(pickle.loads(pickle.dumps(batch))), rows)
    assert alike(list(Batch.of([{"x": np.float64(0.1), "n": np.int64(3)}])), [{"x": 0.1, "n": 3}])


def test_a_table_is_the_sequence_of_its_rows():
    rows = rows_of_two_kinds()
    table = Table([Batch.of(rows[:70]), rows[70:80], [], Batch.of(rows[80:])])
    assert len(table) == len(rows)
    assert table == rows
    assert table != rows[:-1]
    assert table != [*rows[:-1], {}]
    for i in (0, 69, 70, 79, 80, len(rows) - 1, -1, -len(rows)):
        assert alike(table[i], rows[i])
    assert alike(table[65:85:3], rows[65:85:3])
    for i in (len(rows), -len(rows) - 1):
        with pytest.raises(IndexError):
            table[i]
    chosen = Selection(table, lambda row: row.get("kind") == "section")
    expected = [row for row in rows if row.get("kind") == "section"]
    assert (list(chosen), len(chosen), chosen[3], chosen[-2]) == (expected, len(expected), expected[3], expected[-2])
    with pytest.raises(IndexError):
        chosen[len(expected)]
    assert len(Table([])) == 0


SWEEP = {"parameter": "clearance", "values": np.linspace(0.06, 0.12, 8).tolist(), "dt": 1e-3, "transient": 1}
CASE = replace(sb.paper_case(10), cells=6)


def test_a_sweep_in_columns_is_the_sweep_in_a_list(monkeypatch, tmp_path):
    listed = sb.study("sweep", CASE, periods=70, **SWEEP)
    assert isinstance(listed.rows, list)
    monkeypatch.setattr(runner, "LISTED", 0)
    for folder in (None, tmp_path, tmp_path):
        columns = sb.study("sweep", CASE, periods=70, folder=folder, **SWEEP)
        assert isinstance(columns.rows, Table)
        assert alike(list(columns.rows), listed.rows)
    assert str(columns) == str(listed)
    assert columns.to_dict() | {"seconds": 0} == listed.to_dict() | {"seconds": 0}
    assert columns.to_dataframe().equals(listed.to_dataframe())
    drawn = [[line.get_xydata() for axes in x.figure().axes for line in axes.lines] for x in (columns, listed)]
    assert len(drawn[0]) > 2
    for a, b in zip(*drawn, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_damaged_column_is_evaluated_again(tmp_path):
    whole = sb.study("sweep", CASE, periods=70, folder=tmp_path, **SWEEP)
    (file,) = tmp_path.glob("*.jsonl")
    lines = file.read_text().splitlines()
    assert all('"table"' in line for line in lines)
    entry = json.loads(lines[2])
    entry["table"]["columns"][0][0][2] = ["another"]
    file.write_text("\n".join([*lines[:2], json.dumps(entry), *lines[3:]]) + "\n")
    again = []
    resumed = sb.study("sweep", CASE, periods=70, folder=tmp_path, **SWEEP, progress=lambda *x: again.append(x[1:]))
    assert again[1:] == [(len(lines) - 1, len(lines)), (len(lines), len(lines))]
    assert alike(resumed.rows, whole.rows)


def test_a_value_takes_a_thousand_bytes_and_little_more(tmp_path):
    """60 numbers of a section are 480 bytes."""
    values, periods = 64, 60
    rows = []
    for i in range(values):
        shared = {"parameter": "frequency", "second": None, "method": "HHT", "dt": 1e-4 + i, "frequency": 8.0 + i}
        rows.append(shared | {"kind": "contact", "count": i, "peak_force": 0.1 * i})
        rows += [shared | {"kind": "section", "period": k, "tip": FLOATS[(i * k) % 500]} for k in range(periods)]
    batch = Batch.of(rows)
    size = sum(c.codes.nbytes + sum(map(sys.getsizeof, c.values or [])) for some in batch.columns for c in some)
    assert size / values < 1000
    with Journal(tmp_path, "sweep", CASE) as journal:
        journal.keep({"values": [[8.0 + i] for i in range(values)]}, rows)
    (file,) = tmp_path.glob("*.jsonl")
    assert file.stat().st_size / values < 1000
