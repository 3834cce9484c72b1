"""A normal belief about standard parameters, and what it says of base parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.estimation import Information
from dynident.estimation.deviations import null_space
from dynident.regressors.model import Model

_NULL = 1e-9


@dataclass(frozen=True, eq=False)
class Belief:
    """A belief about standard parameters: each is `mean` (c,) with the standard deviation `size` (c,).

    Where `stated` (c,) is false nothing is believed: mean and size are then only the order of magnitude. `spread`
    (c, c): where it is given, errors of the stated parameters are its product with independent ones of size one, and
    `size` is an order of magnitude there, too.
    """

    mean: FloatArray
    size: FloatArray
    stated: BoolArray
    spread: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Parted:
    """A belief in two independent parts: what it says of base parameters, and the rest.

    `base`: rows for the base parameters (b,). `rest` (k, c): rows for the standard parameters, counted from their mean
    and in units of their size, that say what the base parameters do not.
    """

    base: Information
    rest: FloatArray


def parted(model: Model, belief: Belief) -> Parted:
    """The belief as rows for the base parameters, and rows for what the base parameters leave open."""
    grouping, stated = model.base.grouping, belief.stated
    # In units of the beliefs' sizes, and each base parameter in that of its own.
    scaled = grouping * belief.size
    errors = np.eye(int(stated.sum()))
    if belief.spread is not None:
        errors = belief.spread[np.ix_(stated, stated)] / belief.size[stated][:, None]
    row_size = np.linalg.norm(np.where(model.base.written, scaled, 0.0), axis=1)
    scaled = scaled / row_size[:, None]
    unknown = np.where(model.base.written, scaled, 0.0)[:, ~stated]
    untouched = null_space(unknown.T, size=1.0).T
    seen = untouched @ scaled[:, stated] @ errors
    left, singular, right = np.linalg.svd(seen, full_matrices=False)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), 1.0)
    whiten = (left[:, enough] / singular[enough]).T @ untouched
    factor = whiten / row_size
    base = Information(factor, factor @ (grouping @ np.where(stated, belief.mean, 0.0)))
    rest = np.zeros((len(errors), len(belief.mean)))
    rest[:, stated] = (np.eye(len(errors)) - right[enough].T @ right[enough]) @ np.linalg.inv(errors)
    return Parted(base, rest)
