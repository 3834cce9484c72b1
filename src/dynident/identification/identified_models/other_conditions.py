"""Say what differs in held-out recordings: another load, another friction, other temperatures.

Says what negative friction means as well: wrong columns, or a controller that compensates friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import get_role
from dynident.estimation import Reduction
from dynident.identification.description_prior import FRICTION_ROLES, has_plain_friction
from dynident.identification.identified_models.identification_result import Identification
from dynident.identification.standard_parameters import find_bodies
from dynident.identification.thresholds import OVERFIT
from dynident.number_format import format_number, format_percent
from dynident.recordings import Recording
from dynident.regressors.errors_by_phase import compute_moving_errors

_FELT, _LEFT = 1e-9, 0.1
"""Relative size of the parameters of a load below which the motion shows none; share of the error that a cause may
leave, where the held-out motion has more than noise, as at starts and stops."""


_FELT_SHARE = 0.3
"""Share of the largest torque by which friction differs that another one has to be named, a tenth of its square."""

_MUCH_LESS = 0.5
"""Share of what a rival leaves that a load may leave to be clear: less is chance where both have about ten numbers."""


@dataclass(frozen=True, eq=False)
class _HeldOutResidual:
    """Held-out rows over their noise: in all base parameters (m, b), the residual (m,) and how many rows it has.

    `by_gains` is the squared residual that a gain for each joint leaves.
    """

    rows: FloatArray
    residual: FloatArray
    n_rows: float
    by_gains: float

    def solve(self, change: FloatArray) -> tuple[FloatArray, float]:
        """Return what of some changes (b, c) of the parameters explains most, and the squared residual it leaves."""
        observed = self.rows @ change
        sizes = np.maximum(np.linalg.norm(observed, axis=0), np.finfo(float).tiny)
        amounts = np.linalg.lstsq(observed / sizes, self.residual, rcond=_FELT)[0] / sizes
        return amounts, float(((self.residual - observed @ amounts) ** 2).sum())

    def explains(self, unexplained: float) -> bool:
        """Return whether a cause leaves what the fit leaves, or hardly any, and much less than gains of the joints."""
        most = max(OVERFIT**2 * self.n_rows, _LEFT**2 * float(self.residual @ self.residual))
        return unexplained <= most and self.by_gains > OVERFIT**2 * unexplained


@dataclass(frozen=True, eq=False)
class OtherLoad:
    """A load that recordings have and the fit has not.

    Parameters
    ----------
    link : str
        The link that carries it, by its joint.
    mass : float
        By how much it is heavier than in the fit, kg.
    change : (b,)
        By how much the base parameters differ.
    is_clear : bool
        Whether it explains much more than a rival, if there is one.
    """

    link: str
    mass: float
    change: FloatArray
    is_clear: bool = True

    def __str__(self) -> str:
        """Return "2.4 kg more on joint7"."""
        return f"{abs(self.mass):.2g} kg {'more' if self.mass > 0.0 else 'less'} on {self.link}"


def describe_other_conditions(identification: Identification) -> str:
    """Say what differs in the held-out recordings, another load or friction; "" where neither explains their error.

    Parameters
    ----------
    identification : Identification
        The identified model.
    """
    data = identification.data.held_out
    if data is None or identification.model.robot.linkage is not None:
        return ""
    residual = _compute_residual(identification, data)
    if (load := _find_load(identification, residual)) is None:
        return _describe_other_friction(identification, residual)
    left = compute_moving_errors(data, identification.values + load.change).relative_total
    return (
        f"the validation recording may carry another load: {load} than in the fit leaves "
        f"{format_percent(left, decimals=1)}. If so, validate with the load of the fit, or identify with the one that "
        "the model is for."
    )


def find_other_load(identification: Identification, data: Reduction, rival: Sequence[int] = ()) -> OtherLoad | None:
    """Return the load by which data differ from those of the fit; None where none explains them.

    Parameters
    ----------
    identification : Identification
        The identified model.
    data : Reduction
        The joints' torques.
    rival : sequence of int
        Columns of the data, behind the model's, of what may explain them as well.
    """
    if identification.model.robot.linkage is not None:
        return None
    residual = _compute_residual(identification, data, len(rival))
    if (load := _find_load(identification, residual)) is None or not rival:
        return load
    by_load = residual.residual - residual.rows[:, : len(load.change)] @ load.change
    by_rival = residual.solve(np.eye(residual.rows.shape[1])[:, list(rival)])[1]
    return replace(load, is_clear=float(by_load @ by_load) < _MUCH_LESS * by_rival)


def _compute_residual(identification: Identification, data: Reduction, n_more: int = 0) -> _HeldOutResidual:
    values = np.pad(identification.values, (0, n_more))
    rows, residuals, by_gains = [], [], 0.0
    for equation, sigma in zip(data.equations, identification.estimate.noise, strict=True):
        factor = equation.whole_factor / (sigma or 1.0)
        own = np.zeros((len(factor), len(values)))
        own[:, equation.columns] = factor[:, :-1]
        predicted = own @ values
        gain = float(predicted @ factor[:, -1]) / max(float(predicted @ predicted), np.finfo(float).tiny)
        by_gains += float(((factor[:, -1] - gain * predicted) ** 2).sum())
        rows.append(own)
        residuals.append(factor[:, -1] - predicted)
    n_rows = sum(float(equation.counts.sum()) for equation in data.equations)
    return _HeldOutResidual(np.concatenate(rows), np.concatenate(residuals), n_rows, by_gains)


def _find_load(identification: Identification, residual: _HeldOutResidual) -> OtherLoad | None:
    # A load changes the ten parameters of the last link alone, so that few numbers have to explain all joints' torques.
    model = identification.model
    inner = {joint.parent for joint in model.robot.joints}
    reach = sum(float(np.linalg.norm(joint.placement[:3, 3])) for joint in model.robot.joints)
    links = {name for place, name in enumerate(model.robot.joint_names) if place not in inner}
    n_base, width = len(model.base.grouping), residual.rows.shape[1]
    grouping = np.pad(model.base.grouping, ((0, width - n_base), (0, 0)))
    for body in find_bodies(model.columns):
        if body.link not in links:
            continue
        change = grouping[:, body.columns]
        load, unexplained = residual.solve(change)
        # Mass and centre have to be a body's: any ten numbers explain some of any error.
        mass, centre = float(load[-1]), float(np.linalg.norm(load[6:9]))
        if residual.explains(unexplained) and abs(mass) > 0.0 and centre <= reach * abs(mass):
            return OtherLoad(body.link, mass, (change @ load)[:n_base])
    return None


def _describe_other_friction(identification: Identification, residual: _HeldOutResidual) -> str:
    columns = identification.model.kept
    roles = {role: [k for k, column in enumerate(columns) if get_role(column) == role] for role in FRICTION_ROLES}
    places = [place for own in roles.values() for place in own]
    change, unexplained = residual.solve(np.eye(len(columns))[:, places])
    if not places or not residual.explains(unexplained):
        return ""
    changes = dict(zip(places, change, strict=True))
    names = {"dry": "Coulomb friction", "damping": "viscous friction"}
    torques = dict(zip(places, np.linalg.norm(residual.rows[:, places] * change, axis=0), strict=True))
    felt = {k: role for role, own in roles.items() for k in own if torques[k] >= _FELT_SHARE * max(torques.values())}
    if 2 * len({columns[k].link for k in felt}) <= len({columns[k].link for k in places}):
        # The drives of some joints alone, as after a repair. A share of what is hardly there would say nothing.
        texts = [f"{names[felt[k]]} of {columns[k].link} by {changes[k]:+.2g} {columns[k].unit}" for k in felt]
        words = ", ".join(texts)
    else:
        texts = [
            f"{names[role]} by {100.0 * float(np.median([changes[k] / identification.values[k] for k in own])):+.0f} %"
            for role, own in roles.items()
            if own
        ]
        words = f"{', '.join(texts)}, the median over the joints"
    return (
        f"only friction differs in the validation recording ({words}), as if the drives were warmer or colder. Make "
        "both recordings at the same temperature, or record the fit from cold to warm: a fit over a few degrees holds "
        "only for these."
    )


def describe_temperatures(recordings: Sequence[Recording], validation: Sequence[Recording]) -> tuple[str, ...]:
    """Say that the held-out recordings have temperatures that the fit has not; nothing where none were recorded.

    Parameters
    ----------
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.
    """
    if not validation or not all(recording.has_temperature for recording in (*recordings, *validation)):
        return ()
    (low, high), (held_low, held_high) = (_find_temperatures(own) for own in (recordings, validation))
    # As far outside the fit's range as this is wide, friction is not known from it.
    if max(held_low - high, low - held_high) <= high - low:
        return ()
    return (
        f"The joints have {held_low:.0f} to {held_high:.0f} degC in the validation data and {low:.0f} to {high:.0f} in "
        "the fit: their friction differs there, and the fit does not show how it depends on temperature.",
    )


def _find_temperatures(recordings: Sequence[Recording]) -> tuple[float, float]:
    blocks = (block for recording in recordings for block in recording.source.rows(0, recording.n_samples, 1 << 16))
    means = [np.nanmedian(block.temperature, axis=0) for block in blocks if block.temperature is not None]
    return float(np.min(means)), float(np.max(means))


def warn_of_friction_signs(identification: Identification) -> list[str]:
    """Warn of negative friction, which would drive the motion: a sign or the order of joints is probably wrong.

    Beside other friction effects a negative part is possible, so only plain models are judged.

    Parameters
    ----------
    identification : Identification
        The identified model.
    """
    if not has_plain_friction(identification.model):
        return []
    friction = [
        (parameter, role)
        for parameter, column in zip(identification.parameters, identification.model.kept, strict=True)
        if (role := get_role(column)) in FRICTION_ROLES and not column.runs
    ]
    # Three standard deviations: noise alone takes hardly any of a dozen parameters that far below zero.
    negative = [
        (parameter, role) for parameter, role in friction if parameter.value < -3.0 * parameter.standard_deviation
    ]
    joints = {parameter.link for parameter, _ in friction}
    # A torque that leads the motion takes damping away, but no Coulomb friction.
    wrong = {parameter.link for parameter, role in negative if role == "dry"}
    # Turned signs, of torques or of positions, turn masses as well: the inertia matrix is then not positive definite.
    if len(wrong) > 1 and 2 * len(wrong) > len(joints) and identification.inertia_matrix_positive_definite:
        where = "all joints" if wrong == joints else "most joints"
        names = ", ".join(parameter.name for parameter, _ in negative)
        return [
            f"Friction is negative on {where} ({names}): these are probably not the torques of the drives, but what "
            "the controller asks for beside its compensation of friction. Record the measured torque or current, or "
            "switch that compensation off."
        ]
    return [
        f"{parameter.name} on {parameter.link} is negative ({format_number(parameter.value)} {parameter.unit}): check "
        "the sign of its torque and the order of the torque columns."
        for parameter, _ in negative
    ]
