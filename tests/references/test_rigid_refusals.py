"""What rigid stops are refused for, by schemes, references and ensembles that cannot take them."""

from __future__ import annotations

import pytest
from rigid_chain import INF, chain
from systems import one_mass

import stiffbeam as sb
from stiffbeam import InputError


def test_members_are_all_of_one_kind():
    system, _ = chain(1)
    soft = sb.System.from_matrices(
        system.mass, system.stiffness, loads=system.loads,
        contacts=[sb.Contact(system.contacts[0].row, sb.Stops(lower=-0.3, upper=0.2, stiffness=1e3))],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"member|matrices|load"):
        sb.integrate_ensemble(system, sb.BDF2(), 0.02, 1.0, [system, soft])
    with pytest.raises(InputError, match="members"):
        sb.integrate_ensemble(system, sb.BDF2(), 0.02, 1.0, sb.varied_members(system, stops=[soft.contacts[0].stops]))


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: sb.integrate(chain(1)[0], sb.MoreauJean(), 0.01, 1.0), "restitution"),
        (lambda: sb.integrate(chain(1, e=0.5)[0], sb.BDF2(), 0.01, 1.0), "restitution"),
        (lambda: sb.integrate(chain(1)[0], sb.ExponentialFlow(), 0.01, 1.0), "grow"),
        (lambda: sb.integrate(chain(1)[0], sb.BDF2(), 0.01, 1.0, contact="conserving"), "contact|conserve"),
        (lambda: sb.integrate(chain(1)[0], sb.BDF2(), 0.01, 1.0, contact="extrapolated"), "contact"),
        (lambda: sb.integrate(chain(1, "coupling", e=0.5)[0], sb.MoreauJeanBilbao(), 0.01, 1.0), "decouple"),
        (lambda: sb.reference(chain(1)[0], 1.0, method="cvode"), "finite"),
        (lambda: sb.reference(chain(1)[0], 1.0, method="multiprecision"), "finite for multiprecision"),
        (lambda: sb.lyapunov(chain(1)[0], 1.0), "restitution"),
        (lambda: chain(1)[0].ode(), "finite"),
    ],
)
def test_what_is_refused(call, named):
    with pytest.raises(InputError, match=named):
        call()


def test_compliant_stops_and_starts_beyond_rigid_ones_are_refused():
    compliant = one_mass(1.0, sb.Stops(upper=0.1, stiffness=5.0))
    with pytest.raises(InputError, match="trapezoidal"):
        sb.integrate(compliant, sb.MoreauJean(), 0.01, 1.0)
    stops = sb.Stops(upper=0.1, stiffness=INF)
    beyond = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)], initial_displacement=[0.2])
    with pytest.raises(InputError, match="between"):
        sb.integrate(beyond, sb.BDF2(), 0.01, 1.0)
    twice = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)] * 2)
    with pytest.raises(InputError, match="follow"):
        sb.integrate(twice, sb.BDF2(), 0.01, 1.0)
