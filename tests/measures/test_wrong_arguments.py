"""Arguments of another type, such as a text for a run: the error names the argument, its rule and a remedy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from systems import bouncing_chain

import stiffbeam as sb


@cache
def chain() -> sb.System:
    return bouncing_chain()


@cache
def motion() -> sb.Reference:
    return sb.reference(chain(), 0.1)


EYE = np.eye(3)
STIFF = np.diag([1.0, 2.0, 3.0])
CALLS = {
    "want": lambda x: sb.study("advise", chain(), t_end=1.0, want=x),
    "schemes": lambda x: sb.study("advise", chain(), t_end=1.0, want={"tip": 1e-2}, schemes=x),
    "contacts": lambda x: sb.study("advise", chain(), t_end=1.0, want={"tip": 1e-2}, contacts=x),
    "case": lambda x: sb.study("doubt", x, dt=1e-2, t_end=1.0, uncertain={"stiffness": (2.9, 3.1)}),
    "period": lambda x: sb.periodic_orbit(chain(), x),
    "mass": lambda x: sb.modal_damping(x, EYE, 0.02),
    "t_end": lambda x: sb.perturbed_members(chain(), 2, t_end=x),
    "parameters": lambda x: sb.varied_members(chain(), x),
    "progress": lambda x: sb.integrate(chain(), sb.HHT(), 1e-2, 0.1, progress=x),
    "run": sb.contact_rates,
    "tangents": lambda x: sb.contact_rates(motion(), tangents=x),
    "problems": lambda x: sb.score("hht", x),
    "states": lambda x: sb.Trajectory.from_arrays([0.0, 0.1, 0.2], system=chain(), states=x),
    "wrt": motion().derivative,
    "file": lambda x: motion().animate(x),
    "beside": lambda x: motion().animate("film.gif", x),
    "loads": lambda x: sb.reduce_model(EYE, STIFF, loads=x, modes=1),
    "contacts of a model": lambda x: sb.reduce_model(EYE, STIFF, contacts=x, modes=1),
    "observe": lambda x: sb.reduce_model(EYE, STIFF, observe=x, modes=1),
    "stiffness": lambda x: sb.reduce_model(EYE, x, modes=1),
    "damping": lambda x: sb.reduce_model(EYE, STIFF, x, modes=1),
    "initial_velocity": lambda x: sb.reduce_model(EYE, STIFF, initial_velocity=x, modes=1),
}
WRONG = [-1.0, [1j, "x"], object()]


@pytest.mark.parametrize("argument", CALLS)
@pytest.mark.parametrize("wrong", WRONG, ids=["number", "list", "object"])
def test_an_argument_of_another_type_is_named(argument, wrong):
    with pytest.raises(sb.InputError) as error:
        CALLS[argument](wrong)
    first = {
        "beside": ("beside", "runs"),
        "problems": ("problems", "problem"),
        "schemes": ("schemes", "integrator"),
        "observe": ("observe", "loads, contacts and observe"),
    }
    assert error.value.field.partition(".")[0] in first.get(argument, (argument.partition(" ")[0],))
    assert error.value.remedy
