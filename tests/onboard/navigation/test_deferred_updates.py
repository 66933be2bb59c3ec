"""Test that deferred updates equal immediate ones."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.onboard.navigation.error_state import POSE
from lunarsim.onboard.navigation.schmidt_kalman_covariance import DeferredUpdates
from tests.onboard.navigation.states import alike, made

TAIL = 12


def plainly(p, squares, is_frozen):
    """Subtract squares entry by entry, as a filter with frozen errors does."""
    out = p.copy()
    for w, resting in squares:
        for i in range(len(p)):
            for j in range(len(p)):
                if not (resting and is_frozen[i] and is_frozen[j]):
                    out[i, j] -= sum(w[k, i] * w[k, j] for k in range(len(w)))
    return out


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_squares_are_subtracted_from_active_rows(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    root = rng.normal(size=(n + 2, n + 2))
    p, is_frozen = root @ root.T, rng.random(n) < 0.6
    squares = [
        (rng.normal(size=(rng.integers(1, 4), n)), bool(rng.random() < 0.5)) for _ in range(4)
    ]
    kept, got = DeferredUpdates(), p.copy()
    for w, resting in squares:
        kept.add(w, np.flatnonzero(~is_frozen) if resting else None)
    assert kept.rows == sum(len(w) for w, _ in squares)
    # Columns of active errors are not updated in the rows of frozen errors.
    if kept.apply(got):
        lags = np.ix_(is_frozen, ~is_frozen)
        assert not np.array_equal(got[:n, :n], got[:n, :n].T)
        got[:n, :n][lags] = got[:n, :n].T[lags]
    assert np.array_equal(got[:n, :n], got[:n, :n].T)
    assert got[:n, :n] == pytest.approx(plainly(p[:n, :n], squares, is_frozen), abs=1e-12)
    assert np.array_equal(got[n:], p[n:]) and np.array_equal(got[:, n:], p[:, n:])
    assert kept.rows == 0
    again = got.copy()
    kept.apply(again)
    assert np.array_equal(again, got)


def steps(state, rng):
    """Apply a random operation of navigation to a state."""
    head, size = state.head, state.size
    what = rng.integers(0, 10)
    if what <= 3:  # lander and blocks only, like an altimeter or a star tracker
        columns = rng.permutation(head)[: rng.integers(1, 7)]
        state.measure(
            rng.normal(size=(2, len(columns))), columns, 1e-3 * rng.normal(size=2), np.ones(2)
        )
    elif what == 4:  # with rocks
        columns = rng.permutation(size)[:6]
        state.measure(rng.normal(size=(3, 6)), columns, 1e-3 * rng.normal(size=3), np.full(3, 0.5))
    elif what == 5:
        root = rng.normal(size=(6, 6))
        state.update_with_information(POSE, root @ root.T, 1e-3 * rng.normal(size=6))
    elif what == 6:
        state.freeze_tail(rng.random(state.tail) < 0.7)
    elif what == 7:
        state.propagate(1e-4 * rng.normal(size=(3, 3)), 1e-2 * rng.normal(size=(3, 3)))
    elif what == 8:
        one = int(rng.integers(size))
        state.replace_by_sum(one, rng.permutation(np.delete(np.arange(size), one))[:3],
                     np.array([0.5, 0.3, 0.2]), 0.1)  # fmt: skip
        state.raise_variances(np.array([one]), 2.0)
        state.add_process_noise(rng.permutation(size)[:2], 0.1 * np.eye(2))
    else:
        state.clone("key", POSE)
        state.reserve(state.tail + int(rng.integers(0, 9)))


@given(st.integers(0, 10_000))
@settings(max_examples=60)
def test_time_of_reading_covariance_has_no_effect(seed):
    """Read one state after every step, and the other only at the end."""
    rng = np.random.default_rng(seed)
    put = made(rng, TAIL)
    asked = copy.deepcopy(put)
    for _ in range(25):
        alike((put, asked), steps, rng)
        asked.covariance.sum()
    head, wanted = np.arange(put.head), asked.covariance
    assert put.covariance_of(head) == pytest.approx(wanted[np.ix_(head, head)], rel=1e-7, abs=1e-9)
    assert put.covariance == pytest.approx(wanted, rel=1e-7, abs=1e-9)
    assert put.inertial.position == pytest.approx(asked.inertial.position, abs=1e-9)


def test_number_of_deferred_rows_is_limited():
    rng = np.random.default_rng(2)
    put = made(rng, TAIL)
    asked = copy.deepcopy(put)
    kept = DeferredUpdates()
    for number in range(100):
        for state in (put, asked):
            draws = np.random.default_rng(number)
            state.measure(draws.normal(size=(3, 5)), np.arange(5), np.zeros(3), np.full(3, 1e3))
        asked.covariance.sum()
        if not kept.is_full:
            kept.add(np.zeros((3, TAIL)), None)
    assert 200 < kept.rows < 300
    assert put.covariance == pytest.approx(asked.covariance, rel=1e-9)


def test_deferred_updates_use_errors_frozen_at_that_time():
    rng = np.random.default_rng(4)
    state = made(rng, TAIL)
    first = np.arange(TAIL) < 9
    state.freeze_tail(first)
    before = state.covariance.copy()
    state.measure(np.eye(1, 3), np.arange(3), np.zeros(1), np.ones(1))
    state.freeze_tail(~first)
    resting = state.head + np.flatnonzero(first)
    block = np.ix_(resting, resting)
    assert np.array_equal(state.covariance[block], before[block])


def test_frozen_errors_are_not_corrected():
    state = made(np.random.default_rng(6), TAIL)
    is_frozen = np.arange(TAIL) < 9
    state.freeze_tail(is_frozen)
    corrections = []
    state.listeners.append(corrections.append)
    state.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    behind = corrections[0][state.head :]
    assert not behind[is_frozen].any() and behind[~is_frozen].all()
