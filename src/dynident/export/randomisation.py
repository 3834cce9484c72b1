"""Draw models around an identified one: feasible links, rotors, friction and offsets, with a disturbance of the torque.

For those who train policies in simulation. The estimates are more certain than the model is true: what an effect that
the model lacks does to the motion is not in their covariance. So the file has two parts. Draws of the parameters follow
the covariance of the estimates. A random torque at every joint, as large and as slow as the residual on held-out data,
stands for what the model lacks.

A link's pseudo-inertia is L Lᵀ, with the lower triangular L of the identified link and a random change of every entry.
Every L is a body that can exist (Wensing, Kim and Slotine 2018), so that no draw is thrown away. Rotors and friction
are drawn by their logarithms. The coordinates are normal around zero, with the prior standard deviations below
and the covariance of the base parameters as their likelihood.

Holds the prior standard deviations of the coordinates.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Role, get_role
from dynident.errors import DynidentError
from dynident.export.comments_and_names import describe_identification, describe_origin, make_slug
from dynident.export.feasible_completion import LinkUnknowns
from dynident.export.feasible_links_and_joints import ExportedFile, FeasibleLinks
from dynident.identification import Identification
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.robot.pseudo_inertia import inertial_parameters, pseudo_inertia
from dynident.robot.robot_model import INERTIAL_NAMES

HELD_ROLES: tuple[Role, ...] = ("link", "rotor", "dry", "damping", "constant")
"""Roles of the parameters that are drawn."""
_TEN = len(INERTIAL_NAMES)
# Prior standard deviations of the coordinates. What the data do not determine of a link varies by a twentieth, so
# that it stays a link of this size; the torque hardly depends on it. Rotors, friction and offsets are left to the data.
_LINK, _ROTOR, _FRICTION = 0.05, 0.5, 1.0
Converted = TypeVar("Converted")
"""What an array is converted to."""
# Models that are drawn at once.
_AT_ONCE = 4000
# s: how fast the residual of an arm usually changes, where no recording says it.
_USUAL_TIME = 0.5
# Entries of a lower triangle of four rows: the coordinates of a link, and of its pseudo-inertia.
_ENTRIES = tuple((i, j) for i in range(4) for j in range(i + 1))
# Draws in the file, for programs that want no code.
_IN_FILE = 1000


@dataclass(frozen=True, eq=False)
class TorqueDisturbance:
    """A random torque at each joint, which stands for what the model lacks: a Markov process with normal values.

    Parameters
    ----------
    deviation : (n,)
        Standard deviation, in N m or N.
    time : (n,)
        Correlation time in s: the correlation of values that are t apart is exp(-t / time).
    """

    deviation: FloatArray
    time: FloatArray

    def draw(self, count: int, steps: int, period: float, seed: int = 0) -> FloatArray:
        """Return `count` disturbances (count, steps, n), one value each `period` seconds.

        Parameters
        ----------
        count, steps : int
            Number of disturbances, and of steps of each.
        period : float
            Time between two steps, in s.
        seed : int
            Seed of the random numbers.

        Examples
        --------
        >>> disturbance = TorqueDisturbance(deviation=np.array([2.0, 0.5]), time=np.array([0.5, 0.1]))
        >>> disturbance.draw(count=10, steps=500, period=0.002).shape
        (10, 500, 2)
        """
        rng = np.random.default_rng(seed)
        values = rng.standard_normal((steps, count, len(self.deviation)))
        share = np.exp(-period / self.time)
        # The first value is already one of the process at rest; each next one keeps a share of the one before.
        for k in range(1, steps):
            values[k] = share * values[k - 1] + np.sqrt(1.0 - share**2) * values[k]
        return np.asarray(np.moveaxis(values, 0, 1) * self.deviation)


@dataclass(frozen=True, eq=False)
class ModelDraws:
    """Drawn models as arrays by body, in the order and the units of MuJoCo's `body_…` and `dof_…`.

    Parameters
    ----------
    mass : (m, n)
        In kg.
    centre : (m, n, 3)
        Centre of mass in m, in the frame of the joint (`body_ipos`).
    inertia : (m, n, 6)
        About the centre of mass, in kg m² and the joint's axes: xx, yy, zz, xy, xz, yz (`fullinertia`).
    armature, frictionloss, damping, offset : (m, n)
        Rotor inertia, Coulomb and viscous friction, and a constant torque of the joint, which the motors bear.
    """

    mass: FloatArray
    centre: FloatArray
    inertia: FloatArray
    armature: FloatArray
    frictionloss: FloatArray
    damping: FloatArray
    offset: FloatArray

    def convert(self, function: Callable[[FloatArray], Converted]) -> dict[str, Converted]:
        """Return the arrays by name, each converted: `convert(jax.numpy.asarray)` gives arrays of JAX."""
        return {field.name: function(getattr(self, field.name)) for field in fields(self)}


@dataclass(frozen=True, eq=False)
class ModelDistribution:
    """The joint distribution of a model's parameters, with the disturbance that stands for what the model lacks.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the n joints, in the order of every array.
    base_names : tuple of str
        Names of the b base parameters.
    values : (b,)
        Their identified values, those of feasible links.
    covariance : (b, b)
        Their covariance.
    links, rotors : (l,), (r,)
        Numbers of the joints that have a link, or a rotor, of their own in the model.
    roots : (l, 4, 4)
        Lower triangular L of each identified link.
    rotor_values : (r,)
        Rotor inertias.
    others : (f,)
        Base parameters that are friction or a constant torque.
    other_joints, other_roles : (f,)
        Their joints, and their roles: "dry", "damping" or "constant".
    other_values, other_scales : (f,)
        Their values, and what a coordinate of one is for a constant torque.
    grouping : (b, 10 l + r)
        How links and rotors group into base parameters.
    factor : (k, d)
        Coordinates of a draw for d independent standard normal numbers.
    disturbance : TorqueDisturbance
        The torque to be added at every joint.

    Examples
    --------
    >>> distribution = ModelDistribution.load("randomisation.npz")  # doctest: +SKIP
    >>> distribution.draw(100_000, seed=1).mass.shape  # doctest: +SKIP
    (100000, 6)
    """

    joint_names: tuple[str, ...]
    base_names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    links: IndexArray
    rotors: IndexArray
    roots: FloatArray
    rotor_values: FloatArray
    others: IndexArray
    other_joints: IndexArray
    other_roles: tuple[str, ...]
    other_values: FloatArray
    other_scales: FloatArray
    grouping: FloatArray
    factor: FloatArray
    disturbance: TorqueDisturbance

    def draw(self, count: int, seed: int = 0) -> ModelDraws:
        """Return so many models, all feasible.

        Parameters
        ----------
        count : int
            Number of models m.
        seed : int
            Seed of the random numbers.
        """
        parts = [self._to_draws(coordinates) for coordinates in self._iter_coordinates(count, seed)]
        return ModelDraws(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(ModelDraws)))

    def draw_base_parameters(self, count: int, seed: int = 0) -> FloatArray:
        """Return the base parameters (m, b) of the same models that `draw` returns."""
        return np.concatenate([self._to_base(coordinates) for coordinates in self._iter_coordinates(count, seed)])

    def save(self, path: str | Path) -> None:
        """Write the distribution to a file (.npz)."""
        Path(path).write_bytes(self.to_bytes())

    def to_bytes(self, about: str = "", draws: ModelDraws | None = None) -> bytes:
        """Return the file: an archive of arrays that `numpy.load` reads, with draws and a text about the model."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "disturbance"}
        arrays |= {f"disturbance_{name}": value for name, value in vars(self.disturbance).items()}
        if draws is not None:
            arrays |= {f"drawn_{name}": value for name, value in draws.convert(np.asarray).items()}
        file = io.BytesIO()
        content: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
        np.savez_compressed(file, about=np.array(about), **content)
        return file.getvalue()

    @classmethod
    def load(cls, path: str | Path) -> ModelDistribution:
        """Return the distribution that a file holds.

        Raises
        ------
        DynidentError
            Where the file is no such file.
        """
        try:
            with np.load(path, allow_pickle=False) as read:
                arrays = {name: read[name] for name in read.files}
            names: dict[str, Any] = {
                name: tuple(arrays[name].tolist()) for name in ("joint_names", "base_names", "other_roles")
            }
            disturbance = TorqueDisturbance(arrays["disturbance_deviation"], arrays["disturbance_time"])
            rest: dict[str, Any] = {
                f.name: arrays[f.name] for f in fields(cls) if f.name not in (*names, "disturbance")
            }
        except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
            raise DynidentError(f"{path} is no randomisation file of dynident ({error})", pointer=str(path)) from error
        return cls(**names, **rest, disturbance=disturbance)

    @property
    def prior(self) -> FloatArray:
        """Prior standard deviations (k,) of the coordinates."""
        counts = (_TEN * len(self.links), len(self.rotors), len(self.others))
        return np.repeat([_LINK, _ROTOR, _FRICTION], counts)

    def _iter_coordinates(self, count: int, seed: int) -> Iterator[FloatArray]:
        """Yield the coordinates of so many models, in parts that fit into a processor's cache."""
        rng = np.random.default_rng(seed)
        jacobian = self.compute_jacobian()
        for first in range(0, max(count, 1), _AT_ONCE):
            normal = rng.standard_normal((min(_AT_ONCE, count - first), self.factor.shape[1]))
            drawn = normal @ self.factor.T
            # What the coordinates' curvature adds to the base parameters is taken back by one step. It leaves at
            # most about a standard deviation of the most certain ones.
            step = (self.values + drawn @ jacobian.T - self._to_base(drawn)) @ self._way_back.T
            yield drawn + np.clip(step, -self.prior, self.prior)

    @cached_property
    def _way_back(self) -> FloatArray:
        """Coordinates (k, b) that change the base parameters, in the directions that move them most for their prior."""
        jacobian = self.compute_jacobian()
        weighted = self.prior[:, None] ** 2 * jacobian.T
        # Directions in which bodies move the base parameters by less than these are uncertain are left alone: there
        # the slope is no guide for steps as large as needed.
        total = jacobian @ weighted + self.covariance
        sizes = np.sqrt(np.maximum(np.diag(total), 1e-300))
        inverse = np.linalg.pinv(total / np.outer(sizes, sizes), 1e-12, True)
        return np.asarray(weighted @ (inverse / np.outer(sizes, sizes)))

    def compute_jacobian(self) -> FloatArray:
        """Return the slope (b, k) of the base parameters over the coordinates, at the identified model."""
        step = 1e-5
        ahead, behind = (self._to_base(sign * step * np.eye(len(self.prior))) for sign in (1.0, -1.0))
        return np.asarray((ahead - behind).T / (2 * step))

    def _compute_moments(self, coordinates: FloatArray) -> FloatArray:
        """Return the entries (10, m, l) of the links' pseudo-inertias, in the order of `_ENTRIES`."""
        n_links = len(self.links)
        changes = np.moveaxis(coordinates[:, : _TEN * n_links].reshape(-1, n_links, _TEN), -1, 0).copy()
        # Entry by entry: NumPy's products of many matrices of four rows take ten times as long.
        entries = {
            place: self.roots[:, place[0], place[1]] + self._sizes[:, place[0]] * changes[k]
            for k, place in enumerate(_ENTRIES)
        }
        products = (sum(entries[i, k] * entries[j, k] for k in range(j + 1)) for i, j in _ENTRIES)
        return np.array(list(products))

    @cached_property
    def _sizes(self) -> FloatArray:
        """Sizes (l, 4) of the rows of each link's root: √(second moment) three times, and √mass."""
        squares = np.einsum("lij,lij->li", self.roots, self.roots)
        moments = np.repeat(squares[:, :3].mean(axis=1, keepdims=True), 3, axis=1)
        return np.asarray(np.sqrt(np.column_stack([moments, squares[:, 3]])))

    @cached_property
    def _from_moments(self) -> FloatArray:
        """How the entries of the links' pseudo-inertias, link by link, group into base parameters: (10 l, b)."""
        units = np.zeros((_TEN, 4, 4))
        for k, (i, j) in enumerate(_ENTRIES):
            units[k, i, j] = units[k, j, i] = 1.0
        of_links = self.grouping[:, : _TEN * len(self.links)].reshape(len(self.values), -1, _TEN)
        grouped = np.einsum("blp,ep->leb", of_links, inertial_parameters(units))
        return np.asarray(grouped.reshape(-1, len(self.values)))

    def _to_joint_values(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotors (m, r), and friction and constant torques (m, f)."""
        first = _TEN * len(self.links)
        of_rotors, of_others = np.split(coordinates[:, first:], [len(self.rotors)], axis=1)
        constant = np.array([role == "constant" for role in self.other_roles], dtype=bool)
        with np.errstate(over="ignore"):
            grown = self.other_values * np.exp(of_others)
        return self.rotor_values * np.exp(of_rotors), np.where(
            constant, self.other_values + self.other_scales * of_others, grown
        )

    def _to_base(self, coordinates: FloatArray) -> FloatArray:
        """Return the base parameters (m, b)."""
        moments = np.moveaxis(self._compute_moments(coordinates), 0, -1).reshape(len(coordinates), -1)
        rotors, others = self._to_joint_values(coordinates)
        base = moments @ self._from_moments + rotors @ self.grouping[:, _TEN * len(self.links) :].T
        base[:, self.others] += others
        return np.asarray(base)

    def _to_draws(self, coordinates: FloatArray) -> ModelDraws:
        m, n = len(coordinates), len(self.joint_names)
        rotors, others = self._to_joint_values(coordinates)
        moments = dict(zip(_ENTRIES, self._compute_moments(coordinates), strict=True))
        mass, centre, inertia = np.zeros((m, n)), np.zeros((m, n, 3)), np.zeros((m, n, 6))
        mass[:, self.links] = moments[3, 3]
        for k in range(3):
            centre[:, self.links, k] = moments[3, k] / moments[3, 3]
        # Second moments about the centre of mass; their trace minus themselves is the inertia.
        about = {(i, j): moments[i, j] - moments[3, i] * moments[3, j] / moments[3, 3] for i, j in _ENTRIES if i < 3}
        trace = about[0, 0] + about[1, 1] + about[2, 2]
        for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1))):
            inertia[:, self.links, k] = trace - about[i, j] if i == j else -about[i, j]
        by_joint = {role: np.zeros((m, n)) for role in ("rotor", "dry", "damping", "constant")}
        by_joint["rotor"][:, self.rotors] = rotors
        for column, (joint, role) in enumerate(zip(self.other_joints, self.other_roles, strict=True)):
            by_joint[role][:, joint] += others[:, column]
        return ModelDraws(mass, centre, inertia, *by_joint.values())


def build_distribution(
    identification: Identification, disturbance: TorqueDisturbance | None = None, *, nearest: bool = False
) -> ModelDistribution:
    """Return the joint distribution of a model's links, rotors, friction and constant torques.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    disturbance : TorqueDisturbance, optional
        What stands for the effects that the model lacks, best by `measure_disturbance`. By default it is as large as
        the residual on held-out data (of the fit, where there are none), and changes within half a second.
    nearest : bool
        If no bodies that can exist have the identified parameters, draw around the nearest that can.

    Returns
    -------
    ModelDistribution
        The distribution, to draw from.

    Raises
    ------
    DynidentError
        As `complete_parameters` does.
    """
    return build_distribution_of_links(
        FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest), disturbance
    )


def build_distribution_of_links(
    links: FeasibleLinks, disturbance: TorqueDisturbance | None = None
) -> ModelDistribution:
    """Return the distribution around feasible links and joints, as `build_distribution` does."""
    projected, standard = links.projected, links.standard
    unknowns = LinkUnknowns.from_model(projected.model)
    names, columns = projected.model.robot.tree.joint_names, projected.model.kept
    link_numbers = np.array(unknowns.links, dtype=np.intp)
    # A rotor without inertia stays without: it has no logarithm.
    spinning = np.array([standard.rotors[j] > 0 for j in unknowns.rotors], dtype=bool)
    rotor_numbers = np.array(unknowns.rotors, dtype=np.intp)[spinning]
    chosen = np.append(np.ones(_TEN * len(link_numbers), dtype=bool), spinning)
    grouping = unknowns.grouping[:, chosen]
    parameters = np.append(standard.inertias[link_numbers].ravel(), standard.rotors[rotor_numbers])
    # What links and rotors do not explain of the base parameters are friction and constant torques.
    rest = standard.values - grouping @ parameters
    positive = ("dry", "damping")
    rows = [
        k
        for k, column in enumerate(columns)
        if get_role(column) == "constant" or (get_role(column) in positive and rest[k] > 0)
    ]
    deviations = projected.statistics.standard_deviations
    distribution = ModelDistribution(
        joint_names=tuple(names),
        base_names=tuple(column.name for column in columns),
        values=standard.values,
        covariance=projected.statistics.covariance,
        links=link_numbers,
        rotors=rotor_numbers,
        roots=_factorise(pseudo_inertia(standard.inertias[link_numbers])),
        rotor_values=standard.rotors[rotor_numbers],
        others=np.array(rows, dtype=np.intp),
        other_joints=np.array([names.index(columns[k].link) for k in rows], dtype=np.intp),
        other_roles=tuple(str(get_role(columns[k])) for k in rows),
        other_values=rest[rows],
        other_scales=np.maximum(np.abs(rest[rows]), 10 * deviations[rows]),
        grouping=grouping,
        factor=np.zeros((0, 0)),
        disturbance=disturbance or _guess_disturbance(projected),
    )
    return replace(distribution, factor=_build_factor(distribution))


def _factorise(matrices: FloatArray) -> FloatArray:
    """Return lower triangular L (l, 4, 4) with L Lᵀ = J, also of bodies at the border of the feasible ones."""
    # Cholesky's algorithm fails where rounding makes an eigenvalue negative.
    eigenvalues, vectors = np.linalg.eigh(matrices)
    roots = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))[:, None, :]
    return np.asarray(np.linalg.qr(roots.swapaxes(-1, -2)).R.swapaxes(-1, -2))


def _build_factor(distribution: ModelDistribution) -> FloatArray:
    """Return the factor of the coordinates' covariance, prior and covariance of the base parameters together."""
    prior, jacobian = distribution.prior, distribution.compute_jacobian()
    scaled = jacobian * prior
    total = scaled @ scaled.T + distribution.covariance
    sizes = np.sqrt(np.maximum(np.diag(total), 1e-300))
    inverse = np.linalg.pinv(total / np.outer(sizes, sizes), 1e-12, True)
    left = scaled / sizes[:, None]
    # The prior's covariance minus what the data say, in units of the prior; rounding may leave eigenvalues below zero.
    roots, vectors = np.linalg.eigh(np.eye(len(prior)) - left.T @ inverse @ left)
    return np.asarray(prior[:, None] * vectors * np.sqrt(np.maximum(roots, 0.0)))


def _guess_disturbance(identification: Identification) -> TorqueDisturbance:
    """Return a disturbance as large as the residual where joints move, which changes within half a second."""
    held_out = identification.data.held_out
    data = identification.data.training if held_out is None else held_out
    deviation = compute_moving_errors(data, identification.values).rms
    return TorqueDisturbance(deviation, np.full(len(deviation), _USUAL_TIME))


def to_randomisation(identification: Identification, *, nearest: bool = False) -> ExportedFile:
    """Return the joint distribution of a model's parameters, with a thousand draws, as an archive for `numpy.load`.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    nearest : bool
        If no bodies that can exist have the identified parameters, draw around the nearest that can.

    Returns
    -------
    ExportedFile
        The file, which `ModelDistribution.load` reads, with notes on what it could not hold.

    Raises
    ------
    DynidentError
        As `complete_parameters` does.
    """
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest)
    distribution = build_distribution_of_links(links)
    notes = (
        *links.notes,
        "The disturbance is as large as the residual of this model. How fast it changes is a guess (0.5 s); "
        "dynident.export.measure_disturbance measures both on recordings.",
    )
    about = "\n".join([f"Models drawn around an identified one, {describe_origin()}.",
                       *describe_identification(identification), *notes])  # fmt: skip
    content = distribution.to_bytes(about, distribution.draw(_IN_FILE))
    name = f"{make_slug(identification.model.robot.name)}_randomisation.npz"
    return ExportedFile(name, "application/octet-stream", content, notes)
