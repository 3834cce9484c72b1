"""The catalogue: the ordered list of all built-in effects, plug-ins by entry points, and look-up by id.

Effects of other distributions need one Python file and one entry point each:

    [project.entry-points."dynident.effects"]
    my_effect = "my_package.my_effect:MyEffect"

The object is a subclass of `Effect` or an instance of one. An effect that cannot be loaded, or fails on a trial robot,
is left out with a warning that says why: a broken package of somebody else must not stop an identification.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points

from dynident import effects
from dynident.effects.effect import Column, Effect, ParameterSpec, Role
from dynident.effects.effect_signals import Signals
from dynident.effects.friction import (
    Coulomb,
    CoulombAsymmetric,
    LoadDependentFriction,
    PositionDependentFriction,
    Stribeck,
    TemperatureFriction,
    Viscous,
    ViscousAsymmetric,
    ViscousNonlinear,
    WarmUpFriction,
)
from dynident.effects.gears import Backlash, JointElasticity
from dynident.effects.link_and_rotor_inertia import RigidBody, RotorInertia
from dynident.effects.mechanical_structure import (
    BaseTilt,
    EncoderZeroError,
    JointSpring,
    KinematicError,
    Offset,
    TorqueRipple,
    TransmissionCoupling,
)
from dynident.effects.motors import DriveGainError, DriveGainSaturation, RotorCoupling, TorqueDelay
from dynident.effects.payload_contact_vibration import BaseVibration, ExternalContact, Payload
from dynident.effects.presliding import BreakAway, Presliding
from dynident.effects.springs import CableForce, GravityCompensator
from dynident.errors import DynidentError, suggest_names
from dynident.robot import robot_from_modified_dh

ENTRY_POINT_GROUP = "dynident.effects"


def load_installed_effects(used_ids: Collection[str]) -> tuple[Effect, ...]:
    """Return the effects of all installed entry points, sorted by name, without those whose id is in use."""
    accepted: dict[str, Effect] = {}
    # By name, so that of two effects with one id it is always the same one that is left out.
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda item: item.name):
        effect = _load_effect(point)
        if effect is None:
            continue
        if effect.id in used_ids or effect.id in accepted:
            warnings.warn(
                f"the effect {effect.id!r} of {point.value} is left out: another effect has this id", stacklevel=2
            )
            continue
        accepted[effect.id] = effect
    return tuple(accepted.values())


def list_package_effects() -> tuple[Effect, ...]:
    """Return all effects that modules of `dynident.effects` define, sorted by module."""
    instances = []
    for module in sorted(pkgutil.iter_modules(effects.__path__), key=lambda item: item.name):
        for value in vars(importlib.import_module(f"{effects.__name__}.{module.name}")).values():
            # Modules import each other's effects: each one counts where it is defined.
            is_defined_here = (
                isinstance(value, type) and issubclass(value, Effect) and value.__module__.endswith(f".{module.name}")
            )
            if is_defined_here and not inspect.isabstract(value) and hasattr(value, "id"):
                instances.append(value())
    return tuple(instances)


def _load_effect(point: EntryPoint) -> Effect | None:
    try:
        # An entry point may name a class or an instance; an effect has no arguments.
        plugin = point.load()
        effect = plugin() if isinstance(plugin, type) else plugin
    except Exception as error:  # whatever somebody else's module raises
        warnings.warn(f"the effect {point.name!r} ({point.value}) cannot be loaded: {error}", stacklevel=3)
        return None
    if not isinstance(effect, Effect) or not all(hasattr(effect, name) for name in _NEEDED):
        warnings.warn(
            f"{point.value} is not an effect: derive it from dynident.effects.Effect and define {', '.join(_NEEDED)}",
            stacklevel=3,
        )
        return None
    try:
        _try_effect(effect)
    except Exception as error:  # whatever somebody else's code raises
        warnings.warn(f"the effect {effect.id!r} ({point.value}) is left out: {error}", stacklevel=3)
        return None
    return effect


def _try_effect(effect: Effect) -> None:
    """Build the effect's columns on a small arm; raise an error if they do not match its specification."""
    robot = robot_from_modified_dh("trial", _TRIAL)
    signals, names = Signals(robot), {spec.name for spec in effect.parameters}
    constants = {spec.name for spec in effect.shapes}
    # Every joint, every candidate of the grid and every shape of a column: later code relies on all of them.
    for joint in effect.applicable(robot):
        for shape in effect.grid(robot, joint):
            if set(shape) != constants:
                raise ValueError(f"its grid has {sorted(shape)}, but its shape constants are {sorted(constants)}")
        columns = effect.columns(signals, (joint,), effect.shape_with_defaults({}))
        if len(columns) != len(names) or {column.parameter for column in columns} != names:
            raise ValueError(
                f"its columns belong to {[c.parameter for c in columns]}, but its parameters are {sorted(names)}"
            )
        for column in columns:
            if column.effect != effect.id or column.torque.shape != (robot.n, 1):
                raise ValueError(f"column {column.name} has the shape {column.torque.shape}, not ({robot.n}, 1)")


# Three revolute joints with axes at odd angles, so that no torque vanishes by symmetry.
_TRIAL = tuple(
    {"antecedent": k, "sigma": 0, "alpha": alpha, "d": 0.3, "theta": 0.0, "r": 0.1, "gamma": 0.0, "b": 0.0}
    for k, alpha in enumerate((0.0, 1.5, 0.4))
)


_NEEDED = ("id", "title", "formula", "parameters", "signature", "sources")


_BUILT_IN_EFFECTS: tuple[Effect, ...] = (
    RigidBody(),
    RotorInertia(),
    Coulomb(),
    Viscous(),
    Offset(),
    CoulombAsymmetric(),
    ViscousAsymmetric(),
    Stribeck(),
    ViscousNonlinear(),
    LoadDependentFriction(),
    TemperatureFriction(),
    WarmUpFriction(),
    TorqueRipple(),
    PositionDependentFriction(),
    Presliding(),
    BreakAway(),
    Backlash(),
    JointElasticity(),
    JointSpring(),
    GravityCompensator(),
    BaseTilt(),
    Payload(),
    TransmissionCoupling(),
    RotorCoupling(),
    DriveGainError(),
    DriveGainSaturation(),
    TorqueDelay(),
    EncoderZeroError(),
    KinematicError(),
    ExternalContact(),
    BaseVibration(),
    CableForce(),
)


class Catalogue(Mapping[str, Effect]):
    """Effects by id.

    Effects of other distributions are loaded on first use, because these distributions import this package.
    """

    def __init__(self) -> None:
        # Ids of effects that were added by `add`, which alone may be replaced.
        self._own_ids: set[str] = set()

    @cached_property
    def _effects(self) -> dict[str, Effect]:
        ours = {effect.id: effect for effect in _BUILT_IN_EFFECTS}
        # An effect in a module of this package that is not listed above comes behind them: a new file is enough.
        ours |= {effect.id: effect for effect in list_package_effects() if effect.id not in ours}
        return ours | {effect.id: effect for effect in load_installed_effects(ours)}

    @contextmanager
    def add_temporarily(self, effect: Effect) -> Iterator[None]:
        """Add an effect that is not installed, or replace that of the same id, within a `with` block."""
        # The order of effects counts too, so that afterwards all of them are put back, not one entry alone.
        before = dict(self._effects)
        self._effects[effect.id] = effect
        try:
            yield
        finally:
            self._effects.clear()
            self._effects.update(before)

    def add(self, effect: Effect) -> None:
        """Add an effect until this process ends, or replace one of the same id that was added so.

        Parameters
        ----------
        effect : Effect
            The effect.

        Raises
        ------
        DynidentError
            Where an effect of the library or of an installed package has the same id.
        """
        if effect.id in self._effects and effect.id not in self._own_ids:
            raise DynidentError(
                f"the id {effect.id!r} belongs to another effect, {self._effects[effect.id].title}; choose another id",
                pointer="id",
                title="Effect not registered",
            )
        # Parameters are found by name, so that two effects in one model must not share one.
        for spec in effect.parameters:
            others = (other for other in self.values() if other.id != effect.id)
            owner = next((other for other in others if spec.name in {own.name for own in other.parameters}), None)
            if owner is not None:
                raise DynidentError(
                    f"{spec.name} is a parameter of another effect, {owner.title}; choose another name",
                    pointer="parameters",
                    title="Effect not registered",
                )
        self._effects[effect.id] = effect
        self._own_ids.add(effect.id)

    def __getitem__(self, identifier: str) -> Effect:
        return self._effects[identifier]

    def __iter__(self) -> Iterator[str]:
        return iter(self._effects)

    def __len__(self) -> int:
        return len(self._effects)


CATALOGUE = Catalogue()


class UnknownEffectError(DynidentError):
    """Error: an effect, joint or shape constant does not exist, or an effect cannot act on a joint.

    Parameters
    ----------
    detail : str
        What does not exist or fit, and what does.
    pointer, title : str, optional
        JSON pointer to the cause in the caller's request, and short name of the kind of error.
    """


def is_plain_friction(identifier: str) -> bool:
    """Return whether an effect is Coulomb or viscous friction, which are straight lines over the speed.

    Parameters
    ----------
    identifier : str
        Id of the effect in the catalogue.
    """
    effect = get_effect(identifier)
    return effect.is_friction and effect.fits_roles(("dry", "damping"))


def get_effect(identifier: str, pointer: str = "") -> Effect:
    """Return the effect with an id.

    Parameters
    ----------
    identifier : str
        Id of the effect in the catalogue.
    pointer : str
        JSON pointer to the id in the caller's request.

    Returns
    -------
    Effect
        The one instance of the effect.

    Raises
    ------
    UnknownEffectError
        If there is none; the message names those there are.
    """
    try:
        return CATALOGUE[identifier]
    except KeyError:
        effect_ids, nearest = ", ".join(CATALOGUE), suggest_names(identifier, CATALOGUE) or "."
        raise UnknownEffectError(
            f"there is no effect {identifier!r}{nearest} The effects are: {effect_ids}",
            pointer=pointer,
            title="Unknown effect",
        ) from None


def get_spec(column: Column) -> ParameterSpec | None:
    """Return the specification of a column's parameter.

    Parameters
    ----------
    column : Column
        A column of W.

    Returns
    -------
    ParameterSpec or None
        None for a column that belongs to no effect, such as the offset of a sensor.
    """
    # Plain, since a fit asks hundreds of times.
    try:
        specs = CATALOGUE[column.effect].parameters
    except KeyError:
        return None
    for spec in specs:
        if spec.name == column.parameter:
            return spec
    return None


def get_role(column: Column) -> Role | None:
    """Return the role of a column's parameter.

    Parameters
    ----------
    column : Column
        A column of W.

    Returns
    -------
    Role or None
        What code outside of the effect has to know of the parameter; None where that is nothing.
    """
    spec = get_spec(column)
    return None if spec is None else spec.role


def get_constant_word(effect: str, name: str, value: float) -> str | None:
    """Return the meaning of a constant that is a choice between kinds; None for a number or an unknown effect.

    Parameters
    ----------
    effect : str
        Id of the effect, which need not be in the catalogue.
    name : str
        Name of the shape constant.
    value : float
        Its value, which stands for the word.
    """
    catalogued = CATALOGUE.get(effect)
    return next((spec.get_word(value) for spec in (catalogued.shapes if catalogued else ()) if spec.name == name), None)
