"""What is finished of a reproduction is taken from its folder, and nothing else."""

from __future__ import annotations

import pytest

from dumont2002 import make as making
from dumont2002.make import make_tables
from dumont2002.reading import Reading


@pytest.fixture
def counted(monkeypatch):
    """``make`` replaced by one that writes a small file; the list of tables it was asked for."""
    asked: list[int] = []

    def made(job):
        asked.append(job.number)
        job.folder.mkdir(parents=True, exist_ok=True)
        (job.folder / "panel-a.svg").write_text("<svg/>", encoding="utf-8")
        return {"numbers": {"table": job.number}, "pictures": [["a", "all", "panel-a.svg"]], "files": ["panel-a.svg"]}

    monkeypatch.setattr(making, "make", made)
    return asked


def test_finished_tables_are_taken_from_the_store(counted, tmp_path):
    first = make_tables([2, 10], Reading(), tmp_path, jobs=1)
    again = make_tables([2, 10, 14], Reading(), tmp_path, jobs=1)
    assert sorted(counted) == [2, 10, 14]
    assert {n: again[n] for n in first} == first
    make_tables([2], Reading("extrapolated"), tmp_path, jobs=1)  # another reading is another table
    make_tables([2], Reading(), tmp_path, jobs=1, members=3)
    assert sorted(counted) == [2, 2, 2, 10, 14]


def test_a_kill_loses_the_running_table_only(counted, tmp_path, monkeypatch):
    whole = making.make

    def killed(job):
        if job.number == 14:
            raise KeyboardInterrupt
        return whole(job)

    monkeypatch.setattr(making, "make", killed)
    with pytest.raises(KeyboardInterrupt):
        make_tables([10, 14], Reading(), tmp_path, jobs=1)
    monkeypatch.setattr(making, "make", whole)
    make_tables([10, 14], Reading(), tmp_path, jobs=1)
    assert counted == [10, 14]
