"""The products that a round of scores needs, taken out of all there are once: of the model, and of candidates with it.

Products of two candidates with each other are never needed, and there are very many of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.products import Products, present

# Candidates at once: what their projections take of memory stays in the cache.
_CHUNK = 128


@dataclass(frozen=True, eq=False)
class Batch:
    """Candidates with k columns each: their numbers (g,), and their columns (g, k) among the `extra` ones."""

    members: IndexArray
    columns: IndexArray

    @property
    def width(self) -> int:
        """Number of columns k."""
        return int(self.columns.shape[1])


def extra_columns(candidates: Sequence[Candidate]) -> IndexArray:
    """(c,): all columns of the candidates, ascending."""
    return np.array(sorted({k for candidate in candidates for k in candidate.columns}), dtype=np.intp)


def batches(candidates: Sequence[Candidate], extra: IndexArray) -> tuple[Batch, ...]:
    """The candidates by their number of columns, in handy portions."""
    made: list[Batch] = []
    for width in sorted({len(candidate.columns) for candidate in candidates}):
        members = np.array([i for i, c in enumerate(candidates) if len(c.columns) == width], dtype=np.intp)
        columns = np.searchsorted(extra, np.array([candidates[i].columns for i in members], dtype=np.intp))
        starts = range(0, len(members), _CHUNK)
        made += [Batch(members[k : k + _CHUNK], columns[k : k + _CHUNK].reshape(-1, width)) for k in starts]
    return tuple(made)


@dataclass(frozen=True, eq=False)
class Block:
    """One joint's products over some stretches: of the model's columns W that it has, the candidates' X, and Y.

    `have` (w,) says which of the model's columns these are; `place` (c,) where each of the candidates' stands among the
    x that the joint has: for those that it lacks at the end, where there are zeros. WᵀW (s, w, w), WᵀX (s, w, x + 1),
    Wᵀy (s, w), Xᵀy (s, x + 1), yᵀy (s,); `pairs` are XᵀX within the candidates of every portion (s, g, k, k).
    """

    have: IndexArray
    place: IndexArray
    ww: FloatArray
    wx: FloatArray
    wy: FloatArray
    xy: FloatArray
    yy: FloatArray
    pairs: tuple[FloatArray, ...]

    @classmethod
    def of(cls, data: Products, joint: int, base: IndexArray, extra: IndexArray, portions: Sequence[Batch]) -> Block:
        """Take what is needed out of a joint's products."""
        where = data.position[joint]
        have, wp = present(where, base)
        xi, xp = present(where, extra)
        place = np.full(len(extra), len(xi), dtype=np.intp)
        place[xi] = np.arange(len(xi))
        y = np.full(1, int((where >= 0).sum()), dtype=np.intp)
        # Whatever stands at the end for the columns that the joint lacks is set to zero.
        padded = np.append(xp, 0)
        wx, xy = data.taken(joint, wp[:, None], padded), data.taken(joint, padded, y)
        wx[:, :, -1], xy[:, -1] = 0.0, 0.0
        pairs = []
        for portion in portions:
            places = where[extra[portion.columns]]
            lacking = places < 0
            places = np.where(lacking, 0, places)
            own = data.taken(joint, places[:, :, None], places[:, None, :])
            own[:, lacking[:, :, None] | lacking[:, None, :]] = 0.0
            pairs.append(own)
        ww, wy = data.taken(joint, wp[:, None], wp), data.taken(joint, wp, y)
        return cls(have, place, ww, wx, wy, xy, data.taken(joint, y, y)[:, 0], tuple(pairs))

    def at(self, stretches: IndexArray) -> Block:
        """Of some of the stretches."""
        return Block(
            self.have,
            self.place,
            self.ww[stretches],
            self.wx[stretches],
            self.wy[stretches],
            self.xy[stretches],
            self.yy[stretches],
            tuple(own[stretches] for own in self.pairs),
        )


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums: WᵀW (b, b), WᵀX (b, c), Wᵀy (b,), Xᵀy (c,), and XᵀX within candidates (g, k, k) by portion."""

    ww: FloatArray
    wx: FloatArray
    wy: FloatArray
    xy: FloatArray
    xx: tuple[FloatArray, ...]

    def minus(self, other: Sums) -> Sums:
        """The products of the rows that are in these and not in the others."""
        return Sums(
            self.ww - other.ww,
            self.wx - other.wx,
            self.wy - other.wy,
            self.xy - other.xy,
            tuple(mine - theirs for mine, theirs in zip(self.xx, other.xx, strict=True)),
        )


@dataclass(frozen=True, eq=False)
class Blocks:
    """Those of all joints, for a model with b columns and candidates with c."""

    n_base: int
    n_extra: int
    portions: tuple[Batch, ...]
    joints: tuple[Block, ...]

    @classmethod
    def of(cls, data: Products, base: IndexArray, candidates: Sequence[Candidate]) -> Blocks:
        """Take what is needed to score the candidates beside the model whose columns are `base` (b,)."""
        extra = extra_columns(candidates)
        portions = batches(candidates, extra)
        joints = tuple(Block.of(data, joint, base, extra, portions) for joint in range(data.n_joints))
        return cls(len(base), len(extra), portions, joints)

    def at(self, stretches: IndexArray) -> Blocks:
        """Of some of the stretches."""
        return Blocks(self.n_base, self.n_extra, self.portions, tuple(joint.at(stretches) for joint in self.joints))

    def summed(self, noise: FloatArray) -> Sums:
        """Over the stretches, each joint in units of its noise (n,)."""
        b, c = self.n_base, self.n_extra
        ww, wx, wy, xy = np.zeros((b, b)), np.zeros((b, c)), np.zeros(b), np.zeros(c)
        xx = [np.zeros((*portion.columns.shape, portion.width)) for portion in self.portions]
        for block, sigma in zip(self.joints, noise, strict=True):
            weight = 1.0 / sigma**2
            own = np.flatnonzero(block.place < block.wx.shape[2] - 1)
            ww[np.ix_(block.have, block.have)] += block.ww.sum(axis=0) * weight
            wx[np.ix_(block.have, own)] += block.wx.sum(axis=0)[:, :-1] * weight
            wy[block.have] += block.wy.sum(axis=0) * weight
            xy[own] += block.xy.sum(axis=0)[:-1] * weight
            for mine, pairs in zip(xx, block.pairs, strict=True):
                mine += pairs.sum(axis=0) * weight
        return Sums(ww, wx, wy, xy, tuple(xx))
