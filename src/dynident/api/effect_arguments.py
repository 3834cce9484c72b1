"""Turn texts, choices and diagnoses into effect choices; register a user's own effects (`register`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar, runtime_checkable

from dynident.api.argument_checks import require
from dynident.effects import CATALOGUE, Effect, EffectChoice
from dynident.effects.effect_text_format import parse_effects
from dynident.errors import DynidentError
from dynident.identification.shape_search import check_choices
from dynident.robot import Robot

if TYPE_CHECKING:
    from dynident.diagnosis import Diagnosis, RankedEffect

_TITLE = "Nothing to add"


@runtime_checkable
class HasDiagnosis(Protocol):
    """Something that has a diagnosis."""

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis as the library gives it."""
        ...


Addition: TypeAlias = "HasDiagnosis | Diagnosis | RankedEffect | EffectChoice | str"
"""What can be added to a model."""


def resolve_effects(effects: str | EffectChoice | Iterable[str | EffectChoice]) -> tuple[EffectChoice, ...]:
    """Return the effects of choices and texts: "default", "stribeck@joint2", "stribeck@joint1+joint2:vs=0.05".

    Parameters
    ----------
    effects : str, EffectChoice, or several of them
        Choices as they are, and texts such as "stribeck@joint2".

    Returns
    -------
    tuple of EffectChoice
        In their order; a text may stand for several.

    Raises
    ------
    DynidentError
        For a text that cannot be read.
    """
    # A text is iterable itself: without this test its letters would be taken for effects.
    items = [effects] if isinstance(effects, (str, EffectChoice)) else effects
    remedy = 'give texts such as "stribeck@joint2", or dy.EffectChoice(…)'
    require(isinstance(items, Iterable) and not isinstance(items, Mapping), effects, "effects", remedy)
    items = list(items)
    for item in items:
        require(isinstance(item, (str, EffectChoice)), item, "an effect", remedy)
    return tuple(
        choice for item in items for choice in ((item,) if isinstance(item, EffectChoice) else parse_effects([item]))
    )


def check_effects(choices: tuple[EffectChoice, ...], robot: Robot) -> tuple[EffectChoice, ...]:
    """Check that a robot can have some effects, and return them.

    Parameters
    ----------
    choices : tuple of EffectChoice
        Effects with their joints and shape constants.
    robot : Robot
        The robot that they shall act on.

    Returns
    -------
    tuple of EffectChoice
        The same.

    Raises
    ------
    DynidentError
        Where there is no such effect or joint, or a shape constant is lacking.
    """
    # Refused here and not minutes later, when the model is built.
    check_choices(choices, robot)
    return choices


def collect_added_effects(additions: Iterable[Addition], robot: Robot) -> tuple[EffectChoice, ...]:
    """Return the effects to be added to a model.

    Parameters
    ----------
    additions : iterable of diagnoses, ranked effects, effect choices and texts
        Of a diagnosis all effects that it recommends.
    robot : Robot
        The robot that they shall act on.

    Returns
    -------
    tuple of EffectChoice
        In their order.

    Raises
    ------
    DynidentError
        Where nothing would be added, or an effect does not fit the robot.
    """
    # Imported late: who adds an effect by its name needs no diagnosis.
    from dynident.diagnosis import Diagnosis, RankedEffect

    choices: list[EffectChoice] = []
    reason = ""
    for item in additions:
        if isinstance(item, (str, EffectChoice)):
            choices += resolve_effects(item)
        elif isinstance(item, RankedEffect):
            choices.append(item.choice)
        elif isinstance(item, (Diagnosis, HasDiagnosis)):
            diagnosis = item if isinstance(item, Diagnosis) else item.diagnosis
            choices += diagnosis.recommended
            # A diagnosis without findings is no error by itself: other arguments may still name effects. Its summary is
            # the reason that is given where nothing is left to add.
            reason = "" if diagnosis.recommended else f"the diagnosis recommends nothing to add: {diagnosis.summary}"
        else:
            raise DynidentError(f"{item!r} is neither a diagnosis nor an effect; write an effect as stribeck@joint2")
    if not choices:
        detail = reason or 'no effect to add is given: give a diagnosis, or effects such as "stribeck@joint2"'
        raise DynidentError(detail, title=_TITLE)
    return check_effects(tuple(choices), robot)


AnyEffect = TypeVar("AnyEffect", bound=Effect | type[Effect])
_NOT_REGISTERED = "Effect not registered"


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
        Its `columns(signals, joints, shape)` returns one `self._column(signals, spec, joint, torque, shape)` for each
        joint and parameter: the torque, N m or N, that a parameter of 1 causes. `signals` has symbols of CasADi, not
        arrays: `signals.q`, `dq`, `ddq`, `sign` (of dq), `temperature` and `load` (the torque that the links are
        predicted to put on the joint, N m or N; with `needs_load = True` in the class) are columns (n, 1) with one
        entry for each joint of the robot, `signals.time` is one symbol, and `signals.dq[j]` is that of joint j. There
        is no axis of time, and `len` and most functions of NumPy fail on them: write `casadi.sin(signals.q[j])`,
        `signals.sign[j]`, `casadi.if_else(signals.dq[j] > 0.1, 1, 0)`. `joints` are numbers of joints, and `shape` has
        the shape constants by name.
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
    # Imported here: every command would load the robot that effects are tried on.
    from dynident.testing import ConformanceError, check_effect

    is_class = isinstance(effect, type) and issubclass(effect, Effect)
    if not (is_class or isinstance(effect, Effect)):
        raise DynidentError(
            f"{effect!r:.60} is no effect; derive a class from dynident.effects.Effect and register that",
            title=_NOT_REGISTERED,
        )
    name = effect.__name__ if isinstance(effect, type) else type(effect).__name__
    try:
        instance = effect() if isinstance(effect, type) else effect
        check_effect(instance, found_again=False)
    except ConformanceError as error:
        raise DynidentError(f"{name} cannot be used: {error}", title=_NOT_REGISTERED) from error
    # The class is the user's own: whatever it raises belongs into the message.
    except Exception as error:
        raise DynidentError(
            f"{name} fails in its check: {type(error).__name__}: {error}. Its columns(signals, joints, shape) return "
            "self._column(…) for each joint; the torque is written with functions of CasADi (casadi.tanh, "
            "casadi.if_else), not with NumPy's or Python's if.",
            title=_NOT_REGISTERED,
        ) from error
    CATALOGUE.add(instance)
    return effect
