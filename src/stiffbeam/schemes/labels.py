"""Schemes as text: ``HHT(alpha=-0.1)@displacement``; ``mymodule:Central(theta=0.5)`` is a class of a user's module."""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import os
import re
import sys
from inspect import signature
from typing import Any

from ..basics.validation import InputError, near, one_of
from ..model.semidiscretisation import ALL_FORMS
from . import ALL
from .scheme import Scheme

LONGEST_RUN = 200  # letters
KNOWN_FORMS = (*ALL_FORMS, "matrices")


def make(name: str, **parameters: Any) -> Scheme:
    """The registered scheme ``name``, or the one that ``module:Class`` names, with its parameters."""
    kind = _registered(name) or (user_class(name) if ":" in name else None)
    if kind is None:
        raise InputError("scheme", name, "be a registered scheme", near(name, ALL))
    # A wrong name is refused here, with the nearest right one, and not by Python's TypeError.
    names = [p for p in signature(kind).parameters if p not in ("args", "kwargs")]
    for parameter in parameters:
        if parameter not in names:
            remedy = near(parameter, names) if names else "leave it out: it has none"
            raise InputError(f"{name}'s parameter", parameter, "be one of its own", remedy)
    return kind(**parameters)


def _registered(name: str) -> type[Scheme] | None:
    """The registered class of this name, without regard to capitals and hyphens: ``moreau-jean``; None for another."""
    plain = name.lower().replace("-", "").replace("_", "")
    return next((kind for each, kind in ALL.items() if each.lower() == plain), None)


def parse_run(text: str, default_form: str = "displacement") -> tuple[Scheme, str]:
    """``name(parameter=value, ...)[@form]`` as (scheme, form).

    For example ``bdf2``, ``HHT(alpha=-0.1)@displacement``, ``SDIRK(gamma=0.4359, nystrom=True)``,
    ``mymodule:Central(theta=0.5)`` for a class of one's own.
    """
    remedy = "for example HHT(alpha=-0.1)@displacement"
    if not isinstance(text, str) or len(text) > LONGEST_RUN:
        raise InputError("scheme", text, f"be a text of at most {LONGEST_RUN} letters", remedy)
    # name or module:Class, arguments in brackets, semi-discrete form.
    match = re.fullmatch(r"\s*([\w.]+:\w+|[\w-]+)\s*(\([^()]*\))?\s*(?:@\s*([\w-]+))?\s*", text)
    if not match:
        if re.search(r"\.(csv|txt|nc|mat|json)$", text):
            remedy = "the columns of a file are compared in Python, by sb.compare([t, tip], reference)"
        raise InputError("scheme", text, "read name(parameter=value, ...)@form", remedy)
    name, arguments, form = match.groups()
    try:
        call: Any = ast.parse(f"call{arguments or '()'}", mode="eval").body
        # Literals only: a label is text from a command line or a file; its values must not run as code.
        named = [(x.arg or "", ast.literal_eval(x.value)) for x in call.keywords]
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):
        raise InputError("scheme", text, "give each parameter a number, True or False", remedy) from None
    if call.args or len(dict(named)) < len(named):
        raise InputError("scheme", text, "name every parameter, and each once", remedy)
    return make(name, **dict(named)), one_of("form", form or default_form, KNOWN_FORMS)


def split_runs(text: str) -> list[str]:
    """A comma-separated list of runs; commas inside parentheses belong to the run."""
    return [part for part in re.split(r",(?![^(]*\))", text) if part.strip()]


def scheme_of(label: str) -> Scheme | None:
    """The scheme that a label names; None where the label names no scheme."""
    try:
        return parse_run(label)[0]
    except InputError:
        return None


def label_of_run(scheme: Scheme) -> str:
    """The label of a run: that of its scheme, with the module of a class that has the name of a registered one."""
    kind, label = type(scheme), str(scheme)
    if kind in ALL.values() or _registered(kind.__name__) is None:
        return label
    # Of a class within another or within a function, the place too: the module may have another of its name.
    return f"{kind.__module__}:{kind.__qualname__}{label.removeprefix(kind.__name__)}"


def short_label(label: str) -> str:
    """The label of a scheme where space is short, parameters to four digits; any other text as it is.

    A module that is not imported stays so: data from others must not run code.
    """
    module, colon, _ = label.partition(":")
    scheme = None if colon and module.strip() not in sys.modules else scheme_of(label)
    return label if scheme is None else scheme.label(digits=4)


# ---------------------------------------------------------------- classes of a user's module


def user_class(name: str) -> type[Scheme]:
    """The Scheme class that ``module:Class`` names. Raises InputError as ``user_object`` does, and for what is none."""
    named = user_object(name)
    if isinstance(named, type) and issubclass(named, Scheme):
        return named
    place, _, wanted = name.partition(":")
    if callable(named) and not isinstance(named, type):
        remedy = "it is a function: score, compare, converge and ensemble take these"
    else:
        of_module = vars(sys.modules[place]).items()
        remedy = near(wanted, [x for x, value in of_module if getattr(value, "__module__", "") == place])
    raise InputError("scheme", name, f"name a Scheme class or a function of {place}", remedy)


def user_object(name: str) -> Any:
    """Object that ``module:name`` names, None where the module has none; the module is looked for in the current folder
    too. Raises InputError for a module that cannot be imported."""
    place, _, wanted = name.partition(":")
    # At the end of the path: a file of the folder must not hide an installed module.
    sys.path.append(os.getcwd())
    try:
        return getattr(importlib.import_module(place), wanted, None)
    except Exception as error:  # whatever a module of others raises
        remedy = f"write {name.replace('.py:', ':')}" if place.endswith(".py") else repr(error)
        raise InputError("scheme", name, "name a module that can be imported", remedy) from None
    finally:
        sys.path.pop()


def user_source(label: str) -> str:
    """Return a hash of the source behind a label ``module:Class(...)`` or ``module:name``, "" for a registered scheme.

    Of the module where it has a file; else, as in a notebook, of the function's code.
    """
    if not isinstance(label, str) or not re.match(r"[\w.]+:\w+(\(|$)", label):
        return ""
    try:
        named = user_object(label.partition("(")[0])
    except InputError:
        return ""
    module = sys.modules.get(getattr(named, "__module__", None) or label.partition(":")[0])
    try:
        source = inspect.getsource(module)  # type: ignore[arg-type]
    # A module without a file.
    except (OSError, TypeError):
        code = getattr(named, "__code__", None)
        source = "" if code is None else f"{code.co_code!r} {code.co_consts!r} {code.co_names!r}"
    return hashlib.sha256(source.encode()).hexdigest() if source else ""
