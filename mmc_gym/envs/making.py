"""Make environments by name: those of this package, and yours."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from typing import Any, TypeAlias

import gymnasium as gym

from mmc_gym._errors import UserError, require
from mmc_gym._modules import import_object, look_here

EnvLike: TypeAlias = "str | Callable[..., gym.Env[Any, Any]]"
"""The id of an environment, "module:Id" as Gymnasium spells it, "module:function", or a function or
class that is called with the arguments and returns an environment."""


def is_own(env: EnvLike) -> bool:
    """Tell whether it is another environment than those that this package registers."""
    spec = gym.registry.get(env) if isinstance(env, str) else None
    return spec is None or not str(spec.entry_point).startswith("mmc_gym.envs.")


def name_of(env: EnvLike) -> str:
    """Return the name of an environment for tables: its id, or that of the function."""
    return env if isinstance(env, str) else getattr(env, "__name__", type(env).__name__)


def make_environment(
    env: EnvLike, control: str | None = None, **arguments: Any
) -> gym.Env[Any, Any]:
    """Make an environment.

    Args:
        env: see `EnvLike`; modules in the working directory are found.
        control: its control mode; None for its own, or that among the arguments.  An environment
            of yours that takes no such argument keeps its own.
        arguments: for its constructor.

    Raises:
        UserError: if there is none of this name, or it does not take the arguments.
    """
    if control is not None:
        try:
            return _made(env, {**arguments, "control": control})
        except TypeError:
            if not is_own(env):
                raise
    try:
        return _made(env, arguments)
    except TypeError as error:
        raise _not_accepted(env, error) from error


def _made(env: EnvLike, arguments: dict[str, Any]) -> gym.Env[Any, Any]:
    if not isinstance(env, str):
        return _checked(env(**arguments), env)
    look_here()
    try:
        return gym.make(env, **arguments)
    except UserError:
        raise
    except (gym.error.Error, ImportError) as error:
        made = _function(env)
        if made is None:
            raise _not_accepted(env, error) from error
    return _checked(made(**arguments), env)


def _function(env: str) -> Callable[..., Any] | None:
    """Return the function that "module:function" names; None if it is another name."""
    if ":" not in env:
        return None
    try:
        found = import_object(env, "env")
    except UserError:
        return None
    return found if callable(found) else None


def _checked(made: Any, env: EnvLike) -> gym.Env[Any, Any]:
    require(isinstance(made, gym.Env), name_of(env), made, "a function that returns an environment")
    checked: gym.Env[Any, Any] = made
    return checked


def _not_accepted(env: EnvLike, error: Exception) -> UserError:
    return UserError(
        f"env must be a reaching environment such as 'MMCReach-v0', got {name_of(env)!r}: {error}"
    )


def code_of(thing: Any) -> str:
    """Return the SHA-256 of the source of a class, or of an environment and its wrappers.

    Empty for what is not the user's; what that imports may change unnoticed.
    """
    kinds = [type(thing)]
    while isinstance(thing, gym.Wrapper):
        thing = thing.env
        kinds.append(type(thing))
    digest = hashlib.sha256()
    theirs = [one for one in kinds if not one.__module__.startswith(("mmc_gym.", "gymnasium."))]
    for kind in theirs:
        try:
            digest.update(inspect.getsource(kind).encode())
        except (OSError, TypeError):  # typed into an interpreter, or compiled
            digest.update(kind.__qualname__.encode())
    return digest.hexdigest() if theirs else ""
