from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from lunarsim.onboard.hazards.shadows.association import GATE, associate


def test_association_is_the_best_of_all_assignments():
    rng = np.random.default_rng(1)
    for _ in range(30):
        d, t = rng.integers(1, 5, 2)
        pixel, rocks = 5.0 * rng.random((d, 2)), 5.0 * rng.random((t, 2))
        radius, size = rng.random(d), rng.random(t)
        eye = np.eye(2)
        i, j, _, _ = associate(
            pixel, np.tile(eye, (d, 1, 1)), radius, np.full(d, 0.1),
            rocks, np.tile(0.5 * eye, (t, 1, 1)), size, np.full(t, 0.1),
        )  # fmt: skip
        cost = ((pixel[:, None] - rocks) ** 2).sum(-1) / 1.5 + (radius[:, None] - size) ** 2 / 0.2

        def total(choice, cost=cost):
            return sum(GATE if k < 0 else cost[n, k] for n, k in enumerate(choice))

        choices = (
            c for c in product(range(-1, t), repeat=d)
            if len({k for k in c if k >= 0}) == sum(k >= 0 for k in c)
        )  # fmt: skip
        mine = np.full(d, -1)
        mine[i] = j
        assert total(mine) == pytest.approx(min(total(c) for c in choices))


def test_a_pair_with_a_rival_is_not_sure():
    eye = np.tile(np.eye(2), (2, 1, 1))
    rocks = np.array([[0.0, 0.0], [1.0, 0.0]])
    near = np.array([[0.4, 0.0], [30.0, 0.0]])
    one = np.ones(2)
    i, j, sure, close = associate(near, eye, one, one, rocks, eye, one, one)
    assert (i.tolist(), j.tolist(), sure.tolist()) == ([0], [0], [False])
    assert close.tolist() == [True, False]
    far = np.array([[0.0, 0.0], [20.0, 0.0]])
    _, _, sure, _ = associate(far, eye, one, one, far, eye, one, one)
    assert sure.all()


def test_nothing_seen_or_nothing_tracked():
    empty, eye = np.empty((0, 2)), np.empty((0, 2, 2))
    none = np.empty(0)
    i, j, sure, close = associate(empty, eye, none, none, empty, eye, none, none)
    assert len(i) == len(j) == len(sure) == len(close) == 0
