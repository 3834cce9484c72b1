"""A normal prior on standard parameters, and the prior on base parameters that follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.estimation import PriorInformation
from dynident.estimation.uncertainty import compute_null_space
from dynident.regressors.model import Model

# Share of the largest singular value below which a combination has no error of its own but rounding.
_NULL = 1e-9


@dataclass(frozen=True, eq=False)
class NormalPrior:
    """A normal prior on standard parameters.

    Parameters
    ----------
    mean : (c,)
        Mean of each parameter.
    size : (c,)
        Standard deviation of each parameter.
    stated : (c,)
        Where it is false nothing is known: mean and size are then only the order of magnitude.
    spread : (c, c) or None
        Where given, errors of the stated parameters are its product with independent ones of size one, and `size` is
        only an order of magnitude there, too.
    """

    mean: FloatArray
    size: FloatArray
    stated: BoolArray
    spread: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class SplitPrior:
    """A prior in two independent parts: what it says of base parameters, and the rest.

    Parameters
    ----------
    base : PriorInformation
        Rows for the base parameters (b,).
    rest : (k, c)
        Rows for the standard parameters, counted from their mean and in units of their size, that say what the base
        parameters do not.
    """

    base: PriorInformation
    rest: FloatArray


def split_prior(model: Model, belief: NormalPrior) -> SplitPrior:
    """Split a prior into rows for the base parameters, and rows for what the base parameters leave open.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    belief : NormalPrior
        Mean and standard deviation of the standard parameters.

    Returns
    -------
    SplitPrior
        Rows for the base parameters, and the rest.
    """
    grouping, stated = model.base.grouping, belief.stated
    # Scale the standard parameters by their standard deviations and every base parameter by its own size, so that kg
    # and kg m² compare.
    scaled = grouping * belief.size
    errors = np.eye(int(stated.sum()))
    if belief.spread is not None:
        errors = belief.spread[np.ix_(stated, stated)] / belief.size[stated][:, None]
    row_size = np.linalg.norm(np.where(model.base.written, scaled, 0.0), axis=1)
    scaled = scaled / row_size[:, None]
    unknown = np.where(model.base.written, scaled, 0.0)[:, ~stated]
    # Only combinations of base parameters that hold no unknown standard parameter have a prior at all.
    untouched = compute_null_space(unknown.T, size=1.0).T
    mapped = untouched @ scaled[:, stated] @ errors
    # The singular values are the standard deviations of independent combinations of base parameters.
    left_vectors, singular, right_vectors = np.linalg.svd(mapped, full_matrices=False)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), 1.0)
    # Whitened rows: each has an error of variance one, and the errors are independent.
    whiten = (left_vectors[:, enough] / singular[enough]).T @ untouched
    factor = whiten / row_size
    base = PriorInformation(factor, factor @ (grouping @ np.where(stated, belief.mean, 0.0)))
    rest = np.zeros((len(errors), len(belief.mean)))
    # The complement of the directions that the base parameters take: independent of them, as the errors are whitened.
    rest[:, stated] = (np.eye(len(errors)) - right_vectors[enough].T @ right_vectors[enough]) @ np.linalg.inv(errors)
    return SplitPrior(base, rest)
