"""Products of a candidate's columns with each other, block by block, beside the model."""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.blocks import JointBlock, ProductBlock, RowBlock
from dynident.diagnosis.candidates.fold_fit import FoldFit
from dynident.diagnosis.candidates.products import sum_by_stretch


def compute_block_products(block: JointBlock, fit: FoldFit) -> tuple[FloatArray, ...]:
    """Return ZᵀZ of every candidate on one joint, block by block; Z = X - W P is what the model leaves of its columns.

    Parameters
    ----------
    block : JointBlock
        Rows or products of the joint.
    fit : FoldFit
        The model, fitted to all blocks.

    Returns
    -------
    tuple of (g, s, k, k)
        One array for each portion of candidates with k columns each.
    """
    projection = fit.projection[block.have]
    if isinstance(block, RowBlock):
        rest = -(projection.T @ block.w)
        has = np.flatnonzero(block.place < len(block.x))
        rest[has] += block.x[block.place[has]]
        products = []
        for portion in fit.portions:
            own = rest[portion.columns]
            pairs = own[:, :, None, :] * own[:, None, :, :]
            products.append(sum_by_stretch(pairs, block.stretch, block.n_stretches).transpose(0, 3, 1, 2))
        return tuple(products)
    assert isinstance(block, ProductBlock)
    products = []
    for portion, pairs in zip(fit.portions, block.pairs, strict=True):
        shift = projection[:, portion.columns].transpose(1, 0, 2)
        # (XᵀW) P, column by column of the candidate.
        mixed = np.einsum("sbgk,gbl->sgkl", block.wx[:, :, block.place[portion.columns]], shift)
        inner = np.einsum("gbk,sbc,gcl->sgkl", shift, block.ww, shift, optimize=True)
        whole = pairs - mixed - mixed.transpose(0, 1, 3, 2) + inner
        products.append(whole.transpose(1, 0, 2, 3))
    return tuple(products)
