"""The problems: texts, systems, and how their answers are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mpmath as mp
import numpy as np
from closed_forms import hunt_crossley, kelvin_voigt, moving_dashpot
from rigid import bouncing_ball, preloaded_chatter, rigid_motion, sticking, sticking_phase
from systems import INF, along, aster, bar, drive, mass, nonsmooth_beam, nonsmooth_mode, paper
from truth import Truth, piecewise

import stiffbeam as sb
from stiffbeam.testset.problem import Problem, matrix

KAPPA, GAP, RESTITUTION = (f"contacts[0].stops.{x}" for x in ("stiffness", "upper", "restitution"))
START, SPEED = "q0[0]", "v0[0]"
FINE, COARSE = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32), (1, 2, 4, 8, 16, 32)


@dataclass(frozen=True)
class Definition:
    """A problem to be made. truth: of the made problem; more: further answers, (value, how) by name.

    steps: ``base`` times ``ladder`` times ``samples``. parameters: paths of known derivatives.
    """

    name: str
    title: str
    source: str
    catches: str
    t_end: float
    data: dict[str, Any]
    truth: Callable[[Problem], Truth] = field(repr=False)
    samples: int = 60
    base: int = 1
    ladder: Sequence[int] = FINE
    order_limit: float = 2.0
    more: Callable[[Truth], dict[str, tuple[Any, str]]] = lambda truth: {}
    parameters: Sequence[str] = ()

    @property
    def steps(self) -> tuple[int, ...]:
        return tuple(self.base * m * self.samples for m in self.ladder)


def linear(problem: Problem) -> Truth:
    return piecewise(problem.system, problem.t_end, problem.samples)


def kept(problem: Problem) -> Truth:
    """The answers that are in the problem's file: many digits are not computed under a record. The exact reference and
    a witness meet them."""
    known = {name: answer.digits for name, answer in sb.problem(problem.name).answers.items()}
    tip, velocity, impacts, releases = (
        list(map(mp.mpf, known[name])) for name in ("tip", "tip_velocity", "impacts", "releases")
    )
    energy = mp.mpf(known["energy"]), mp.mpf(known["energy_scale"]), sb.problem(problem.name).answers["energy"].how
    how = sb.problem(problem.name).answers["tip"].how
    return Truth(how, tip, velocity, impacts, releases, mp.mpf(known["peak_force"]), energy)


def rigid(problem: Problem) -> Truth:
    data = problem.data
    contact, driven = data["contacts"][0], None
    if "loads" in data:
        load = data["loads"][0]
        driven = (load["vector"], load["amplitude"], load["frequency"], load["phase"])
    return rigid_motion(matrix(data["mass"]), matrix(data["stiffness"]), data["initial_displacement"],
                        data["initial_velocity"], contact["row"], contact["upper"], contact["restitution"],
                        problem.t_end, problem.samples, driven)  # fmt: skip


def bilinear_period(k: float, kw: float, gap: float, amplitude: float) -> tuple[Any, str]:
    k, kw, g, A = map(mp.mpf, (k, kw, gap, amplitude))
    w1, w2 = mp.sqrt(k), mp.sqrt(k + kw)
    v = w1 * mp.sqrt(A * A - g * g)
    T = 2 / w1 * (mp.pi - mp.acos(g / A)) + 2 / w2 * mp.atan2(v / w2, k * g / (k + kw))
    return T, "2/w1 (pi - acos(g/A)) + 2/w2 atan2(v/w2, k g/(k + kappa)), v = w1 sqrt(A^2 - g^2)"


def sdnd101(truth: Truth) -> dict[str, tuple[Any, str]]:
    w = mp.sqrt(mp.mpf(10100))
    return {"contact_time": (mp.pi / w, "pi/w, w = sqrt((k + kappa)/m)"),
            "impulse": (2 * mp.mpf(10**6) / w**2, "of one impact: 2 kappa v/w^2")}  # fmt: skip


def continuum(truth: Truth) -> dict[str, tuple[Any, str]]:
    how = "of the continuous bar, by characteristics; the mesh makes it another number"
    return {"continuum_contact_time": (mp.mpf(2) / 3, f"2 L/c, {how}"), "continuum_force": (mp.mpf(300), f"rho c v, "
        f"{how}"),
            "continuum_rebound": (mp.mpf(10), f"v, {how}")}  # fmt: skip


def bouncing(truth: Truth) -> dict[str, tuple[Any, str]]:
    how = "of the continuous bar, rational by characteristics; the mesh makes it another number"
    return {"continuum_period": (mp.mpf(16) / 3, how), "continuum_release": (mp.mpf(5) / 3, how),
            "continuum_impulse": (mp.mpf(800) / 3, how)}  # fmt: skip


def damped_stop(problem: Problem) -> Truth:
    law, u, v = problem.data["contacts"][0], problem.data["initial_displacement"], problem.data["initial_velocity"]
    return kelvin_voigt(1.0, law["stiffness"], law["damping"], u[0], v[0], problem.t_end, problem.samples)


def power_stop(problem: Problem) -> Truth:
    law, u, v = problem.data["contacts"][0], problem.data["initial_displacement"], problem.data["initial_velocity"]
    return hunt_crossley(1.0, law["stiffness"], law["exponent"], law.get("dissipation", 0.0), u[0], v[0],
                         problem.t_end, problem.samples)  # fmt: skip


def ball(problem: Problem) -> Truth:
    return bouncing_ball(1.0, 9.81, 0.5, problem.t_end, problem.samples)


def chatter(problem: Problem) -> Truth:
    return preloaded_chatter(1.0, 0.5, problem.t_end, problem.samples)


def stick(problem: Problem) -> Truth:
    return sticking(-problem.data["initial_velocity"][0], problem.t_end, problem.samples)


def symmetric(problem: Problem) -> Truth:
    """Both masses move as one with k = 10."""
    one = sb.System.from_matrices([[1.0]], [[10.0]], initial_displacement=[-0.02],
                                  contacts=[sb.Contact([1.0], sb.Stops(upper=0.01, stiffness=50.0))])  # fmt: skip
    truth = piecewise(one, problem.t_end, problem.samples)
    truth.energy = (2 * truth.energy[0], 2 * truth.energy[1], truth.energy[2])
    truth.how = "by symmetry one mass on k = 10; " + truth.how
    return truth


DUMONT = "Y. Dumont, Math. Comput. Simul. 60 (2002) 45-83, Table {}; its displacement form"
BARS = (
    "D. Doyen, A. Ern, S. Piperno, SIAM J. Sci. Comput. 33 (2011) 223-249, {} benchmark; the contact node without mass"
)
LAWS = "closed form; parameters chosen here"

DEFINITIONS = [
    Definition(
        "free-oscillator", "A mass that never reaches its stop", LAWS,
        "A stop that acts before the mass reaches it. There is no contact, so every integrator shows its order on "
        "smooth motion. Its order on the problems with contact is compared with this one.",
        6.0, mass(1.0, 10.0, 0.0078125, 0.0, upper=0.01, stiffness=50.0), linear, order_limit=9.0,
        more=lambda truth: {"period": (2 * mp.pi / mp.sqrt(10), "2 pi/sqrt(k/m)")},
    ),
    Definition(
        "bilinear-oscillator", "A mass on a spring with a stop at its rest position", LAWS,
        "The kink of the force at every passage. The period does not depend on the amplitude. A contact that is one "
        "step late, or a force from the previous step, makes the period longer in proportion to the step.",
        4.5, mass(1.0, 10.0, -0.015625, 0.0, upper=0.0, stiffness=50.0), linear, parameters=(KAPPA, GAP, START),
        more=lambda truth: {"frequency": (2 * mp.sqrt(600) / (mp.sqrt(10) + mp.sqrt(60)), "2 w1 w2/(w1 + w2)"),
                            "period": bilinear_period(10.0, 50.0, 0.0, 0.015625)},
    ),
    Definition(
        "bilinear-gap", "A mass on a spring with a gap to its stop", f"{LAWS}, gap and stop of Code_Aster's test "
        f"SDND122",
        "Wrong depth or wrong release of a contact. Time of flight and time of contact differ, and the period depends "
        "on the amplitude. A penetration that is too deep or a release that is too late changes the amplitude and "
        "every later impact.",
        5.0, mass(1.0, 10.0, -0.02, 0.0, upper=0.01, stiffness=50.0), linear, parameters=(KAPPA, GAP, START),
        more=lambda truth: {"period": bilinear_period(10.0, 50.0, 0.01, 0.02)},
    ),
    Definition(
        "mass-on-a-stop", "A mass thrown onto a stiff stop, again and again", "Code_Aster's test SDND101 (V5.01.101)",
        "A contact twelve times shorter than the flight. Steps that resolve the flight do not resolve the contact, and "
        "dissipative schemes lose speed at each contact. The motion starts on the stop with speed.",
        0.8, mass(100.0, 1e4, 0.0, 1.0, upper=0.0, stiffness=1e6), linear, base=2, more=sdnd101,
        parameters=(KAPPA, SPEED),
    ),
    Definition(
        "kelvin-voigt", "A mass against a spring and damper that push only",
        "T. Schwager and T. Poeschel, Granular Matter 9 (2007) 465-469: release where the force is zero",
        "The jump of the force at the entry, and a force that pulls before the release. A damper that pulls gives the "
        "naive restitution 0.729 instead of 0.744.",
        5.0, mass(1.0, 0.0, -0.5, 1.0, upper=0.0, stiffness=1.0, damping=0.2), damped_stop, order_limit=1.0,
        parameters=(KAPPA, "contacts[0].stops.damping", SPEED),
    ),
    Definition(
        "hertz", "A ball on a Hertzian stop", "H. Hertz (1882); closed form",
        "The force is a power 3/2 of the depth, so its slope is zero at the entry. A linear stop with the same peak "
        "force has a different contact time. The law has a potential and returns all the speed.",
        0.03125, mass(1.0, 0.0, -0.0078125, 1.0, upper=0.0, stiffness=1e6, exponent=1.5), power_stop, order_limit=2.5,
        parameters=(KAPPA, START, SPEED),
    ),
    Definition(
        "hunt-crossley", "A ball on a stop that dissipates with depth",
        "K. H. Hunt and F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440-445; restitution by Lambert's W",
        "The damping grows with the depth, so the force is continuous. The restitution depends on lambda v only. The "
        "usual formulas for it (Lankarani-Nikravesh and others) are off by up to 0.5.",
        5.0, mass(1.0, 0.0, -0.5, 1.0, upper=0.0, stiffness=1.0, exponent=1.5, dissipation=1.0), power_stop,
        order_limit=2.5, parameters=(KAPPA, "contacts[0].stops.dissipation", SPEED),
    ),
    Definition(
        "two-mass-chain", "Two masses, the second before a stop", LAWS,
        "Two frequencies without a common period. Impacts occur at irregular intervals and with different speeds. The "
        "other mode carries the error of one impact to the next.",
        20.0, {"mass": [[1.0, 0.0], [0.0, 1.0]], "stiffness": [[2.0, -1.0], [-1.0, 1.0]],
               "initial_displacement": [-0.5, -1.0], "initial_velocity": [0.0, 0.0],
               "contacts": [{"row": [0.0, 1.0], "upper": 0.25, "stiffness": 100.0}]}, linear, base=2,
        parameters=(KAPPA, GAP, START),
    ),
    Definition(
        "elastic-bar", "A bar thrown at a wall", BARS.format("first") + "; Code_Aster's V5.03.100",
        "A wave that runs through the bar and back ends the contact. With mass at the contact node the force "
        "oscillates and the node bounces. Here this node has no mass, so the integrator causes any oscillation of the "
        "force.",
        1.5, bar(20, 0.0, 10.0), linear, more=continuum,
    ),
    Definition(
        "bouncing-bar", "A bar bouncing under gravity", BARS.format("second"),
        "Two contacts per period. The first contact leaves a wave in the bar, and the second one removes it. An energy "
        "error of the first contact changes the second.",
        6.0, bar(20, 10.0, 0.0), linear, base=4, more=bouncing,
    ),
    Definition(
        "aster-beam", "A cantilever pushed onto an elastic support", "Code_Aster's test SDNL104 (V5.02.104), its "
        "data on 8 cubic elements; the support is under the free end, where the force acts",
        "Long and short contacts in one run. A constant force presses the beam on its support from the start, and its "
        "bending waves throw it back.",
        0.3, aster(), linear, base=16, ladder=COARSE, order_limit=0.0,
    ),
    Definition(
        "table10", "The beam between stops", DUMONT.format(10),
        "Stiff stops on a beam of 25 cells. A contact lasts two of the steps of 1e-4 that the paper uses. Neighbouring "
        "motions are still close at t = 0.1. Past t = 0.4 only distributions can be compared.",
        0.1, paper(10), linear, base=50, ladder=COARSE, order_limit=0.0,
    ),
    Definition(
        "table12", "The beam between narrow stops", DUMONT.format(12),
        "The same on 50 cells with a hundredth of the gap and six times the frequency. It is ten times as chaotic. "
        "Compare pointwise to t = 0.01.",
        0.01, paper(12), linear, base=25, ladder=COARSE, order_limit=0.0,
    ),
    Definition(
        "table14", "The beam with one stop", DUMONT.format(14),
        "Long flights, each followed by a burst of impacts. The one stop is just below the rest position.",
        0.2, paper(14), linear, base=50, ladder=COARSE, order_limit=0.0,
    ),
    Definition(
        "hammer-pulse", "Two masses struck by a hammer", LAWS,
        "A triangular pulse of 2 ms in half a second. An adaptive solver may step over it and return the state of "
        "rest. A fixed-step scheme that samples it at the wrong times adds the wrong momentum.",
        0.5, {"mass": [[1.0, 0.0], [0.0, 0.5]], "stiffness": [[20000.0, -10000.0], [-10000.0, 10000.0]],
              "initial_displacement": [0.0, 0.0], "initial_velocity": [0.0, 0.0],
              "loads": [{"vector": [1.0, 0.0], "times": [0.0, 0.125, 0.1259765625, 0.126953125, 0.5],
                         "values": [0.0, 0.0, 500.0, 0.0, 0.0]}],
              "contacts": [{"row": [0.0, 1.0], "upper": 0.001, "stiffness": 1e6}]}, kept, samples=64, base=4,
    ),
    Definition(
        "stop-along-the-beam", "A cantilever with stops at half its length", "the beam of Dumont (2002) on 6 cubic "
        "elements",
        "Stops that are not at the observed point, and that move with the base. The tip is free and moves on after the "
        "stop holds the middle of the beam.",
        0.25, along(), linear, base=16, ladder=COARSE, order_limit=0.0,
    ),
    Definition(
        "two-stops-at-once", "Two masses that meet their stops at the same time", LAWS,
        "Both contacts always close and open at the same instant. A solver that handles one event at a time must not "
        "lose the other. By symmetry each mass is the bilinear oscillator with a gap.",
        5.0, {"mass": [[1.0, 0.0], [0.0, 1.0]], "stiffness": [[15.0, -5.0], [-5.0, 15.0]],
              "initial_displacement": [-0.02, -0.02], "initial_velocity": [0.0, 0.0],
              "contacts": [{"row": [1.0, 0.0], "upper": 0.01, "stiffness": 50.0},
                           {"row": [0.0, 1.0], "upper": 0.01, "stiffness": 50.0}]},
        symmetric, more=lambda truth: {"period": bilinear_period(10.0, 50.0, 0.01, 0.02)},
    ),
    Definition(
        "bouncing-ball", "A ball that comes to rest", "textbook; impacts accumulate at a finite time",
        "Infinitely many impacts before t = 1.3546, and rest after that. An integrator that locates each impact never "
        "reaches this time. One that steps over them must neither fall through the floor nor continue to bounce.",
        1.5, mass(1.0, 0.0, 1.0, 0.0, loads=[{"vector": [1.0], "constant": -9.81}], lower=0.0, stiffness=INF,
                  restitution=0.5), ball, base=2, order_limit=1.0,
    ),
    Definition(
        "preloaded-chatter", "A preloaded mass that chatters to rest", LAWS,
        "The same accumulation of impacts, with flights of 2 atan(e^k) under a spring. The spring then holds the mass "
        "on its stop.",
        4.0, mass(1.0, 1.0, 0.0, -1.0, loads=[{"vector": [1.0], "constant": 1.0}], upper=0.0, stiffness=INF,
                  restitution=0.5), chatter, samples=64, order_limit=1.0,
    ),
    Definition(
        "impact-oscillator", "A periodic orbit of the impact oscillator", "S. W. Shaw and P. J. Holmes, J. "
        "Sound Vib. 90 (1983) 129-155; the rational orbit w = 2, e = 0.8",
        "One impact per period of the drive at speed 20/3, with multipliers 0.8 and 0.8. A wrong restitution leads to "
        "another orbit. An impact that is late by a fraction of the step shifts the orbit by the same fraction.",
        10.0, mass(1.0, 1.0, 0.0, -16.0 / 3.0, loads=drive(-1.0, 2.0, 0.0),
                   upper=0.0, stiffness=INF, restitution=0.8), rigid, order_limit=1.0,
        parameters=(RESTITUTION, SPEED),
        more=lambda truth: {"impact_speed": (mp.mpf(20) / 3, "x'' + x = cos(w t), x <= 0: of the exact orbit"),
                            "grazing_stop": (mp.mpf(1) / 3, "1/|1 - w^2|: the stop that the free motion just touches")},
    ),
    Definition(
        "impact-transient", "Nine impacts of the impact oscillator", "the impact oscillator at w = 2.8, e = 0.8",
        "The motion starts from rest near the stop, with slow and fast impacts and three within 0.6. Near a grazing "
        "contact the impact time is most sensitive.",
        20.0, mass(1.0, 1.0, -0.1, 0.0, loads=drive(1.0, 2.8, float(np.pi / 2)),
                   upper=0.0, stiffness=INF, restitution=0.8), rigid, samples=64, base=8, order_limit=1.0,
        parameters=(RESTITUTION, GAP, START),
    ),
    Definition(
        "nonsmooth-mode", "A nonsmooth mode of two masses", "closed form of nonsmooth modal analysis, one impact a "
        "period, e = 1",
        "A conservative periodic motion of period 10 with one elastic impact. An energy error at the impact or an "
        "error of its time destroys the period.",
        25.0, nonsmooth_mode(), rigid, base=2, order_limit=1.0,
        more=lambda truth: {"period": (mp.mpf(10), "by construction"),
                            "speed_after": (mp.mpf("-0.04387968785686229"), "of the second mass, to 16 digits")},
    ),
    Definition(
        "sticking-phase", "Two masses, one of which sticks", "after H. Le Thi, S. Junca, M. Legrand: periodic "
        "motions with one sticking phase per period",
        "The second mass reaches the stop with zero speed, to rounding, stays for 2.05 and leaves when its contact "
        "force vanishes. The solver must handle a grazing event, a contact without an impact, and a release that the "
        "gap does not show.",
        16.0, {"mass": [[1.0, 0.0], [0.0, 1.0]], "stiffness": [[2.0, -1.0], [-1.0, 1.0]], "observe": [1.0, 0.0],
               "initial_displacement": [1.0, 1.0], "initial_velocity": [-float(sticking_phase()[2]), 0.0],
               "contacts": [{"row": [0.0, 1.0], "upper": 1.0, "stiffness": INF, "restitution": 0.0}]},
        stick, samples=64, base=2, order_limit=1.0,
    ),
    Definition(
        "nonsmooth-beam-mode", "A nonsmooth mode of the beam", "the same construction on the beam of Dumont (2002), "
        "8 cells",
        "Eight modes and one elastic impact per period. A mesh node with mass and e = 1 is the worst "
        "semi-discretisation of rigid contact. Here it has an exact solution.",
        0.3, nonsmooth_beam(), rigid, base=8, ladder=COARSE, order_limit=0.0,
    ),
    Definition(
        "damped-chain", "Two masses with dashpots under a drive, the second between stops", LAWS,
        "A damping matrix with a wrong sign, without its coupling or left out, and a load at the wrong time of the "
        "step. The dashpots couple the modes.",
        12.0, {"mass": [[1.0, 0.0], [0.0, 0.5]], "damping": [[0.375, -0.125], [-0.125, 0.125]],
               "stiffness": [[3.0, -1.0], [-1.0, 1.0]],
               "initial_displacement": [0.0, 0.5], "initial_velocity": [1.0, 0.0],
               "loads": [{"vector": [1.0, 0.0], "amplitude": 2.0, "frequency": 1.5, "phase": 0.5}],
               "contacts": [{"row": [0.0, 1.0], "lower": -0.75, "upper": 1.0, "stiffness": 50.0}]},
        linear, base=2,
    ),
    Definition(
        "moving-dashpot", "A mass on a spring against a stop that moves and has a dashpot", LAWS,
        "A dashpot of the stop that acts against the velocity of the mass alone. The force depends on the velocity "
        "relative to the stop, jumps at the entry, and never pulls.",
        6.0, {"mass": [[1.0]], "stiffness": [[10.0]], "observe": [1.0],
              "initial_displacement": [-0.5], "initial_velocity": [0.0],
              "contacts": [{"row": [1.0], "upper": 0.25, "stiffness": 100.0, "damping": 4.0,
                            "offset": {"amplitude": 0.5, "frequency": 2.0, "phase": 0.0}}]},
        lambda problem: moving_dashpot(problem.data, problem.t_end, problem.samples), order_limit=1.0,
    ),
]  # fmt: skip
