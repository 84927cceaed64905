"""Schemes of anyone's own, by the module and the name of their class: ``mymodule:Central``."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import sys
from collections.abc import Callable
from typing import Any

from ..basics.validation import InputError, near
from .scheme import Scheme


def own_class(name: str) -> type[Scheme]:
    """The Scheme class that ``module:Class`` names; the module is looked for in the current folder too.

    Raises InputError for a module that cannot be imported and for what is no Scheme class in it.
    """
    place, _, wanted = name.partition(":")
    module = _module(place, name)
    found = getattr(module, wanted, None)
    if not isinstance(found, type) or not issubclass(found, Scheme):
        classes = [x for x, value in vars(module).items() if isinstance(value, type) and issubclass(value, Scheme)]
        function = callable(found) and not isinstance(found, type)
        remedy = "it is a function: stiffbeam score takes these" if function else near(wanted, classes)
        raise InputError("scheme", name, f"name a Scheme class of {place}", remedy)
    return found


def own_function(name: str) -> Callable[..., Any] | None:
    """The function that ``module:function`` names, None where that is something else. Raises InputError as above."""
    place, _, wanted = name.partition(":")
    found = getattr(_module(place, name), wanted, None)
    return found if callable(found) and not isinstance(found, type) else None


def _module(place: str, name: str) -> Any:
    try:
        return importlib.import_module(place)
    except ModuleNotFoundError:
        return _from_here(place, name)
    except Exception as error:  # whatever a module of others raises
        raise InputError("scheme", name, "name a module that can be imported", repr(error)) from None


def _from_here(place: str, name: str) -> Any:
    sys.path.append(os.getcwd())
    try:
        return importlib.import_module(place)
    except Exception as error:
        raise InputError("scheme", name, "name a module that can be imported", repr(error)) from None
    finally:
        sys.path.pop()


def own_label(scheme: Scheme) -> str:
    """``module:Class(parameter=value, ...)``, from which another process makes an equal scheme.

    Raises InputError for a class that is not at the top of a module, and where ``parameters`` does not say
    all that the scheme was made with.
    """
    kind, label = type(scheme), str(scheme)
    if "." in kind.__qualname__ or scheme.erratum:
        remedy = "move its class to the top of a module, or use integrate and compare"
        rule = "be registered, or be found in a module, for a study"
        raise InputError("schemes", f"a {kind.__qualname__} called {label}", rule, remedy)
    name, given = f"{kind.__module__}:{kind.__qualname__}", label.removeprefix(scheme.name)
    found = own_class(name)
    try:
        again = found is kind and vars(kind(**scheme.parameters)) == vars(scheme)
    except (TypeError, ValueError):  # other arguments; arrays, which are not simply equal
        again = False
    if not again:
        remedy = "let its property `parameters` give all arguments of its class, as plain numbers"
        raise InputError("schemes", label, f"be made again by {name}{given} for a study", remedy)
    return name + given


def own_source(label: str) -> str:
    """A hash of the module that a label ``module:Class(...)`` names, "" for a registered scheme."""
    if not isinstance(label, str) or ":" not in label:
        return ""
    try:
        module = sys.modules[own_class(label.partition("(")[0]).__module__]
        return hashlib.sha256(inspect.getsource(module).encode()).hexdigest()
    except (InputError, OSError, TypeError, KeyError):
        return ""
