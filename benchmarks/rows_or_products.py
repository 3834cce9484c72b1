"""Scores of candidates read from the rows of W, against reading them from products kept a stretch at a time.

    python benchmarks/rows_or_products.py

Says from how many rows a stretch on products are the quicker way: `_MOST_ROWS` of
`dynident.diagnosis.candidates.inner_product_accumulation`; and from how many on they are fewer numbers, which decides
where joints are many. Every candidate has its two columns on one joint, as friction has. Making the products is part of
their time, and done once; scores are read in some ten rounds of a diagnosis.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from common import FloatArray, show
from numpy.typing import NDArray

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import score_candidates
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, ProductStack, RowStack

JOINTS, BASE, CANDIDATES, STRETCHES, ROUNDS = 6, 60, 240, 150, 10
ROWS = (8, 16, 32, 64, 128, 256)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--candidates", type=int, default=CANDIDATES, help="of two columns each")
    candidates = parser.parse_args().candidates
    rows = [
        ("rows a stretch", "from rows", "from products", "products / rows", "rows / products in memory", "difference")
    ]
    for count in ROWS:
        kept, folded = stacks_of(count, candidates)
        start = time.perf_counter()
        ours = scores(kept, candidates)
        reading = time.perf_counter() - start
        start = time.perf_counter()
        products = [ProductStack(made(stack)) for stack in folded]
        making = time.perf_counter() - start
        start = time.perf_counter()
        theirs = scores(products, candidates)
        other = time.perf_counter() - start
        mine, rival = ROUNDS * reading, making + ROUNDS * other
        difference = float(np.abs(ours / theirs - 1.0).max())
        memory = sum(stack.columns.nbytes for stack in kept) / sum(stack.values.nbytes for stack in products)
        times = f"{mine:.2f} s", f"{rival:.2f} s", f"{rival / mine:.2f}"
        rows.append((f"{count}", *times, f"{memory:.2f}", f"{difference:.0e}"))
    show(f"{JOINTS} joints, {STRETCHES} stretches, {ROUNDS} rounds of {candidates} candidates of two columns", rows)


def stacks_of(count: int, candidates: int) -> tuple[list[RowStack], list[RowStack]]:
    """The same rows of every joint twice: what has been read once is in the cache."""
    random = np.random.default_rng(count)
    row_block = np.repeat(np.arange(STRETCHES), count)
    widths = [len(columns_of(joint, candidates)) + 1 for joint in range(JOINTS)]
    values = [random.normal(size=(len(row_block), width)) for width in widths]
    return tuple([RowStack(each.copy(), row_block, STRETCHES) for each in values] for _ in range(2))


def columns_of(joint: int, candidates: int) -> NDArray[np.intp]:
    """The columns of the model, and of the candidates on a joint."""
    own = [BASE + 2 * k + i for k in range(joint, candidates, JOINTS) for i in range(2)]
    return np.array([*range(BASE), *own], dtype=np.intp)


def made(stack: RowStack) -> FloatArray:
    """(s, p + 1, p + 1): products of every stretch."""
    return np.array([part @ part.T for part in np.split(stack.columns, STRETCHES, axis=1)])


def scores(stacks: list[RowStack] | list[ProductStack], candidates: int) -> FloatArray:
    """(candidates,): squared error that is left with each."""
    width = BASE + 2 * candidates
    position = tuple(np.full(width, -1) for _ in range(JOINTS))
    for joint, where in enumerate(position):
        columns = columns_of(joint, candidates)
        where[columns] = np.arange(len(columns))
    counts, run = np.ones((STRETCHES, JOINTS)), np.zeros(STRETCHES, dtype=np.intp)
    data = Products(tuple((stack,) for stack in stacks), position, counts, run)
    tried = [Candidate("offset", (), (), (BASE + 2 * k, BASE + 2 * k + 1)) for k in range(candidates)]
    _, found = score_candidates(data, np.arange(BASE), tried, np.ones(JOINTS), "interleaved")
    return np.array([score.after.sum() for score in found])


if __name__ == "__main__":
    main()
