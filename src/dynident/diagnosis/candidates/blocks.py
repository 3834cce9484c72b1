"""What a round of scores needs, taken out of all there is once: the model, and candidates with it.

Products of two candidates with each other are never needed, and there are very many of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.batches import Amplitudes, Batch, list_extra_columns, split_batches, split_by_portion
from dynident.diagnosis.candidates.fit import FoldFit, JointSums, ProductSums
from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.product_block import ProductBlock
from dynident.diagnosis.candidates.products import Products, RowStack
from dynident.diagnosis.candidates.row_block import RowBlock


class JointErrors(Protocol):
    """One joint's squared errors in stretches, for a fit on others."""

    @property
    def alone(self) -> FloatArray:
        """(s,): those of the model."""

    def compute_scores(self) -> FloatArray:
        """(s, c): Zᵀρ, Z what the model does not say of every candidate's column, ρ what it leaves."""

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """(g, s): squared errors with each candidate, portion by portion."""


class JointBlock(Protocol):
    """One joint's share: which of the model's columns it has, `have` (w,), and where those of candidates are."""

    @property
    def have(self) -> IndexArray:
        """(w,): which of the model's columns the joint has."""

    @property
    def place(self) -> IndexArray:
        """(c,): where each of the candidates' columns stands among the x that the joint has, x where it lacks it."""

    def select_stretches(self, stretches: IndexArray) -> JointBlock:
        """Of some of the stretches."""

    def sum_products(self) -> JointSums:
        """Over all stretches."""

    def compute_errors(self, fit: FoldFit) -> JointErrors:
        """Its squared errors for a fit."""


@dataclass(frozen=True, eq=False)
class JointBlocks:
    """Those of all joints, for a model with b columns and candidates with c, in `n_stretches`."""

    n_base: int
    n_extra: int
    n_stretches: int
    portions: tuple[Batch, ...]
    joints: tuple[JointBlock, ...]

    @classmethod
    def from_products(cls, data: Products, base: IndexArray, candidates: Sequence[Candidate]) -> JointBlocks:
        """Take what is needed to score the candidates beside the model whose columns are `base` (b,)."""
        extra = list_extra_columns(candidates)
        portions = split_batches(candidates, extra)
        joints = tuple(_build_block(data, joint, base, extra, portions) for joint in range(data.n_joints))
        return cls(len(base), len(extra), data.n_stretches, portions, joints)

    def select_stretches(self, stretches: IndexArray) -> JointBlocks:
        """Of some of the stretches."""
        joints = tuple(joint.select_stretches(stretches) for joint in self.joints)
        return JointBlocks(self.n_base, self.n_extra, len(stretches), self.portions, joints)

    def fit_amplitudes(self, fit: FoldFit) -> Amplitudes:
        """The candidates' parameters, each fitted beside the model."""
        each = tuple(fit.fit_amplitudes(number) for number in range(len(self.portions)))
        return Amplitudes(self.portions, each, fit.projection)

    def sum_products(self, noise: FloatArray) -> ProductSums:
        """Over the stretches, each joint in units of its noise (n,)."""
        b, c = self.n_base, self.n_extra
        ww, wx, wy, xy = np.zeros((b, b)), np.zeros((b, c)), np.zeros(b), np.zeros(c)
        xx = np.zeros(sum(portion.columns.size * portion.width for portion in self.portions))
        for block, sigma in zip(self.joints, noise, strict=True):
            weight = 1.0 / sigma**2
            own = block.sum_products()
            has = np.flatnonzero(block.place < len(own.xy))
            ww[np.ix_(block.have, block.have)] += own.ww * weight
            wx[np.ix_(block.have, has)] += own.wx * weight
            wy[block.have] += own.wy * weight
            xy[has] += own.xy * weight
            xx += own.xx * weight
        return ProductSums(ww, wx, wy, xy, split_by_portion(xx, self.portions))


def _build_block(
    data: Products, joint: int, base: IndexArray, extra: IndexArray, portions: Sequence[Batch]
) -> JointBlock:
    stacks = [stack for stack in data.stacks[joint] if isinstance(stack, RowStack)]
    if len(stacks) == len(data.stacks[joint]):
        return RowBlock.from_stacks(stacks, data.position[joint], (base, extra), portions, data.n_stretches)
    return ProductBlock.from_products(data, joint, base, extra, portions)
