"""Films: frames, and what is refused."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from PIL import Image
from systems import two_contacts

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.figures.animation import animate


@pytest.mark.slow
def test_a_film_has_its_frames_and_they_move(tmp_path, table10):
    system = sb.semidiscretise(table10, 8)
    run, exact = sb.integrate(system, sb.HHT(alpha=-0.1), 1e-4, 0.1), sb.reference(system, 0.1)
    file = exact.animate(tmp_path / "beam.gif", [run], seconds=1.0, frames_per_second=4)
    with Image.open(file) as film:
        assert film.n_frames == 4
        frames = [np.asarray((film.seek(k), film.convert("L"))[1], float) for k in range(4)]
    changed = [np.mean(np.abs(a - b) > 20.0) for a, b in pairwise(frames)]
    assert all(0.0 < share < 0.2 for share in changed)  # curves move, axes stand still
    assert [path.name for path in tmp_path.iterdir()] == ["beam.gif"]


def test_an_interrupted_film_leaves_no_file(tmp_path, table10):
    run = sb.integrate(sb.semidiscretise(table10, 8), sb.HHT(), 1e-3, 0.02)

    def interrupt(what: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        animate([run], tmp_path / "film.gif", seconds=0.2, show=interrupt)
    assert not list(tmp_path.iterdir())


def test_matrices_are_shown_by_their_contacts(tmp_path):
    run = sb.integrate(two_contacts(), sb.BDF2(), 1e-2, 2.0)
    assert run.animate(tmp_path / "chain.gif", seconds=0.5, frames_per_second=4).is_file()


def test_what_cannot_be_filmed_is_refused(tmp_path, monkeypatch, three_masses):
    run = sb.integrate(two_contacts(), sb.BDF2(), 1e-2, 2.0)
    with pytest.raises(InputError, match=r"\.gif or \.mp4"):
        run.animate(tmp_path / "chain.avi")
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda _: False))
    with pytest.raises(InputError, match=r"install ffmpeg, or name it chain\.gif"):
        run.animate(tmp_path / "chain.mp4")
    with pytest.raises(InputError, match="one system"):
        run.animate(tmp_path / "chain.gif", [sb.integrate(three_masses, sb.BDF2(), 1e-2, 2.0)])
    with pytest.raises(InputError, match="integrate again"):
        sb.load(run.save(tmp_path / "run.nc")).animate(tmp_path / "chain.gif")
