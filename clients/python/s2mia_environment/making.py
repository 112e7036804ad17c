"""Makes the environments of `PACKAGE.module:FUNCTION`, and distinguishes the user's mistakes from errors of the environment."""

import functools
import importlib
import inspect
from collections.abc import Callable

from s2mia import wire

from s2mia_environment.environment import Environment, EnvironmentBatch, InvalidEnvironment, OneByOne
from s2mia_environment.parallel import Parallel, declares


def batch_of(function: str, settings: dict) -> EnvironmentBatch:
    """The environments of one stream, made by `PACKAGE.module:FUNCTION` with these arguments.

    Raises `InvalidEnvironment` if there is no such function, it does not take the arguments, or it returns something
    else than an environment. Other errors are those of the environment.
    """
    make = functools.partial(_called, _function(function), function, settings)
    made = make()
    if isinstance(made, EnvironmentBatch):
        return _described(made)
    if isinstance(made, Environment):
        return OneByOne(_described(made), make)
    return OneByOne(Parallel(made), lambda: Parallel(make()))


def _function(place: str) -> Callable:
    """The function at `PACKAGE.module:FUNCTION`."""
    module, _, name = place.partition(":")
    if not all(part.isidentifier() for part in [*module.split("."), name]):
        raise InvalidEnvironment(f"{place} is not of the form PACKAGE.module:FUNCTION, such as games:make")
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        own = error.name is not None and f"{module}.".startswith(f"{error.name}.")
        what = f"there is no module {error.name}" if own else f"{module} needs the module {error.name}"
        advice = "start the program in its folder, or install it, or set PYTHONPATH" if own else "install it"
        raise InvalidEnvironment(f"{what}; {advice}") from error
    if not hasattr(found, name):
        raise InvalidEnvironment(f"the module {module} has no {name}")
    if not callable(getattr(found, name)):
        raise InvalidEnvironment(f"{place} is no function, but {type(getattr(found, name)).__name__}")
    return getattr(found, name)


def _called(function: Callable, place: str, settings: dict):
    """What the function returns."""
    try:
        signature = inspect.signature(function)
    except ValueError:
        # Some functions of C have none.
        signature = None
    try:
        if signature is not None:
            signature.bind(**settings)
    except TypeError as error:
        raise InvalidEnvironment(f"{error}; the arguments of {place} are {signature}, each as NAME=VALUE") from None
    try:
        return function(**settings)
    except (AssertionError, TypeError, ValueError) as error:
        # With arguments, these errors are nearly always about them.
        if not settings or isinstance(error, InvalidEnvironment):
            raise
        raise InvalidEnvironment(f"{type(error).__name__}: {error}; check {', '.join(settings)}") from error


def _described(made):
    """The same environment, if it has a description."""
    if not declares(made, "spec") or not isinstance(made.spec, wire.EnvironmentSpec):
        raise InvalidEnvironment(f"{type(made).__name__} must set spec, a wire.EnvironmentSpec, when it is made")
    return made
