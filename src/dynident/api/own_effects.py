"""Effects that are defined in a notebook or a script."""

from __future__ import annotations

from typing import TypeVar

from dynident.effects import CATALOGUE, Effect
from dynident.errors import DynidentError
from dynident.testing import ConformanceError, check_effect

AnyEffect = TypeVar("AnyEffect", bound=Effect | type[Effect])
_TITLE = "Effect not registered"


def register(effect: AnyEffect) -> AnyEffect:
    r"""Make an effect of one's own usable by its id in this process.

    It is then a candidate of every diagnosis and can be named as any other: `effects=["default", "hose_friction"]`.
    The quick part of `dynident.testing.check_effect` checks it; calling that by itself also simulates a robot with it.

    It holds for this process alone. Jobs of the service and `dynident` on the command line run in other processes and
    do not know it, and a model that contains it can be read only where it was registered before. An effect that shall
    be known everywhere is installed: see docs/own-effects.md.

    Parameters
    ----------
    effect : subclass of Effect, or an instance of one
        Registering another one of the same id replaces it, so that a cell can be run again.

    Returns
    -------
    subclass of Effect, or instance
        The same, so that it can be used as a decorator (`@dy.register`).

    Raises
    ------
    DynidentError
        For what is no effect, does not pass a check, or has the id of another effect.

    Examples
    --------
    >>> import dynident as dy
    >>> from dynident.effects import Effect, ParameterSpec
    >>> class CubicFriction(Effect):
    ...     id = "cubic_friction"
    ...     title = "Cubic friction"
    ...     formula = r"F_3\,\dot q^3"
    ...     parameters = (ParameterSpec("F3", "N m s³/rad³", "friction by the cube of the velocity"),)
    ...     signature = "torque that grows with the cube of the velocity"
    ...     sources = ("our own measurements",)
    ...     is_friction = True
    ...     def columns(self, signals, joints, shape):
    ...         return [self._column(signals, self.parameters[0], j, signals.dq[j] ** 3, {}) for j in joints]
    >>> effect = dy.register(CubicFriction)
    >>> model.extend("cubic_friction@elbow")  # doctest: +SKIP
    """
    is_class = isinstance(effect, type) and issubclass(effect, Effect)
    if not (is_class or isinstance(effect, Effect)):
        raise DynidentError(
            f"{effect!r:.60} is no effect; derive a class from dynident.effects.Effect and register that", title=_TITLE
        )
    name = effect.__name__ if isinstance(effect, type) else type(effect).__name__
    try:
        instance = effect() if isinstance(effect, type) else effect
        check_effect(instance, found_again=False)
    except ConformanceError as error:
        raise DynidentError(f"{name} cannot be used: {error}", title=_TITLE) from error
    # The class is the user's own: whatever it raises belongs into the message.
    except Exception as error:
        raise DynidentError(f"{name} fails in its check: {type(error).__name__}: {error}", title=_TITLE) from error
    CATALOGUE.add(instance)
    return effect
