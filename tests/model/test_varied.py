"""varied: what goes with a drive that is varied, and what is refused."""

from __future__ import annotations

import pytest

import stiffbeam as sb


def test_stops_bolted_to_the_base_and_a_start_with_it_go_with_the_drive():
    """A member is the beam that is built with the other drive."""

    def rig(base):
        stops = [sb.Stops(-0.01, 0.01, stiffness=1e4, motion=base), sb.Stops(None, 0.008, stiffness=1e4, position=0.6)]
        start = sb.PolynomialProfile((float(base.rate(0.0)),))
        return sb.semidiscretise(sb.BeamProblem(stiffness=3.0, stops=stops, base=base, initial_velocity=start), 8)

    system = rig(sb.Harmonic(0.02, 5.0))
    for change, base in (
        ({"amplitude": [0.03]}, sb.Harmonic(0.03, 5.0)),
        ({"frequency": [6.0]}, sb.Harmonic(0.02, 6.0)),
    ):
        member, built = sb.varied_members(system, change)[0], rig(base)
        assert member.fingerprint == built.fingerprint
    slanted = sb.BeamProblem(
        stiffness=3.0, base=sb.Harmonic(0.02, 5.0), initial_velocity=sb.PolynomialProfile((0.1, 1.0))
    )
    with pytest.raises(sb.InputError, match="uniform"):
        sb.varied_members(sb.semidiscretise(slanted, 8), {"amplitude": [0.03]})


def test_matrices_whose_stops_move_with_the_drive_are_not_varied():
    drive = sb.Harmonic(1.0, 2.0)
    contact = sb.Contact([1.0], sb.Stops(None, 0.1, stiffness=50.0), sb.Harmonic(0.01, 2.0))
    system = sb.System.from_matrices([[1.0]], [[4.0]], loads=[([1.0], drive)], contacts=[contact])
    with pytest.raises(sb.InputError, match="no stops that move"):
        sb.varied_members(system, {"amplitude": [2.0]})
