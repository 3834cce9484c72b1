"""Standard parameters of links and rotors as the unknowns of a semidefinite problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import get_effect, get_role
from dynident.errors import DynidentError
from dynident.estimation.constrained_least_squares import MatrixBound
from dynident.identification.parameters.standard_parameters import StandardParameters
from dynident.regressors.model import Model
from dynident.robot.inertia_uncertainty import estimate_inertia_errors, estimate_rotor_inertias
from dynident.robot.model import INERTIAL_NAMES
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS

_TEN = len(INERTIAL_NAMES)
# Radius of gyration, over its size, of a link for which the description has no mass.
_GYRATION = 0.5


@dataclass(frozen=True, eq=False)
class LinkUnknowns:
    """Standard parameters of links and rotors among a model's columns.

    Attributes
    ----------
    model : Model
        The model whose columns they are.
    links, rotors : tuple of int
        Indices of the joints whose link, or whose rotor, is an unknown.
    columns : ndarray (k,)
        Indices of the unknowns among `model.columns`: ten a link, then one a rotor.
    scale, nominal : ndarray (k,)
        Usual error of the description, and its values.
    """

    model: Model
    links: tuple[int, ...]
    rotors: tuple[int, ...]
    columns: IndexArray
    scale: FloatArray
    nominal: FloatArray

    @classmethod
    def from_model(
        cls, model: Model, *, rotors_in_links: bool = False, estimated: StandardParameters | None = None
    ) -> LinkUnknowns:
        """Return the unknowns of a model.

        Parameters
        ----------
        model : Model
            The model whose columns they are.
        rotors_in_links : bool
            Leave out rotors whose inertia is grouped with that of links, so that the links have it all.
        estimated : StandardParameters, optional
            Nominal values instead of the description's.

        Raises
        ------
        DynidentError
            If the model has no rigid body.
        """
        joints = model.robot.tree.joint_names
        rigid = [k for k, column in enumerate(model.columns) if get_role(column) == "link" and not column.runs]
        if not rigid:
            raise DynidentError(
                "the model has no rigid_body, so there are no masses and inertias to write; export C code, a CasADi "
                "function or JSON",
                pointer="/format",
                title="No links in the model",
            )
        base_columns = set(model.base.kept)
        spinning = [
            k
            for k, column in enumerate(model.columns)
            if get_role(column) == "rotor" and not column.runs and (k in base_columns or not rotors_in_links)
        ]
        # Each link has ten columns, one behind the other: every tenth names it.
        links = tuple(joints.index(model.columns[k].link) for k in rigid[::_TEN])
        rotors = tuple(joints.index(model.columns[k].link) for k in spinning)
        doubt = estimate_inertia_errors(model.robot.tree)
        scale = np.concatenate(
            [doubt[list(links)].reshape(-1), estimate_rotor_inertias(model.robot.tree)[list(rotors)]]
        )
        nominal = np.concatenate(
            [_get_described_inertias(model, doubt)[list(links)].reshape(-1), np.zeros(len(rotors))]
        )
        columns = np.array(rigid + spinning, dtype=np.intp)
        # A feasible estimator has found standard parameters already: the completion stays near these instead of the
        # description.
        if estimated is not None:
            nominal = estimated.values[columns]
        return cls(model, links, rotors, columns, scale, nominal)

    @property
    def size(self) -> int:
        """Number of unknowns k."""
        return len(self.columns)

    @property
    def rotor_places(self) -> IndexArray:
        """Places of the rotors among the unknowns."""
        return np.arange(self.size - len(self.rotors), self.size)

    @cached_property
    def base_rows(self) -> IndexArray:
        """Base parameters that are those of links and rotors."""
        inertial = [get_effect(column.effect).is_inertia and not column.runs for column in self.model.kept]
        return np.flatnonzero(inertial)

    @cached_property
    def grouping(self) -> FloatArray:
        """(b, k): how the unknowns, in their own units, group into all base parameters."""
        return np.asarray(self.model.base.grouping[:, self.columns])

    def build_bounds(self, extra: int, slack: FloatArray) -> list[MatrixBound]:
        """Return the bounds that keep the pseudo-inertia of every link positive definite.

        The variables are the unknowns over their scale, then `extra` others. The scaled pseudo-inertia of each link is
        to be at
        least `slack` times the unit matrix; where there are extra variables, the first of them, one a link, are
        subtracted from
        it, too.

        Parameters
        ----------
        extra : int
            Number of variables after the unknowns.
        slack : (l,)
            Least eigenvalue of each link's scaled pseudo-inertia.

        Returns
        -------
        list of MatrixBound
            One bound a link.
        """
        bounds = []
        for place, least in enumerate(slack):
            link_places = slice(_TEN * place, _TEN * (place + 1))
            columns = np.arange(link_places.start, link_places.stop)
            parts = self._scale_pseudo_inertias(place) * self.scale[link_places][:, None, None]
            if extra:
                columns = np.append(columns, self.size + place)
                parts = np.concatenate([parts, -np.eye(4)[None]])
            bounds.append(MatrixBound(columns, parts, -least * np.eye(4)))
        return bounds

    def compute_margins(self, unknowns: FloatArray) -> FloatArray:
        """Return the smallest eigenvalue (l,) of each link's scaled pseudo-inertia, which `build_bounds` bounds."""
        none = np.zeros(len(self.links))
        scaled = unknowns / self.scale
        return np.array([np.linalg.eigvalsh(bound.evaluate(scaled))[0] for bound in self.build_bounds(0, none)])

    def _scale_pseudo_inertias(self, place: int) -> FloatArray:
        """Return the pseudo-inertias (10, 4, 4) of unit parameters, in units of the link's usual mass and size."""
        of_link = self.scale[_TEN * place : _TEN * (place + 1)]
        # Without units, eigenvalues of links of all sizes can be compared, and the solver sees numbers of about one.
        mass, length = of_link[9], np.sqrt(of_link[0] / of_link[9])
        shrink = np.array([1 / length] * 3 + [1.0]) / np.sqrt(mass)
        return np.asarray(PSEUDO_INERTIA_PARTS * shrink[:, None] * shrink)

    def to_standard(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inertias (n, 10) of all links and (n,) of all rotors; zero where the model has none."""
        n = self.model.robot.tree.n
        inertias, rotors = np.zeros((n, _TEN)), np.zeros(n)
        inertias[list(self.links)] = unknowns[: _TEN * len(self.links)].reshape(-1, _TEN)
        rotors[list(self.rotors)] = unknowns[_TEN * len(self.links) :]
        return inertias, rotors


def _get_described_inertias(model: Model, doubt: FloatArray) -> FloatArray:
    """Return inertias (n, 10) of the description, and a ball about the joint's origin for links without mass."""
    inertias = np.zeros_like(doubt) if model.robot.inertias is None else model.robot.inertias.copy()
    for link in np.flatnonzero(inertias[:, 9] <= 0):
        inertias[link] = 0.0
        inertias[link, 9] = doubt[link, 9]
        # XX, YY and ZZ of a ball are equal, and its products of inertia zero.
        inertias[link, [0, 3, 5]] = _GYRATION**2 * doubt[link, 0]
    return inertias
