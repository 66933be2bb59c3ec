"""Test deferred columns, moved errors and inserted rows."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.onboard.navigation.error_state import POSE
from tests.onboard.navigation.states import alike, made

TAIL = 40


def step(state, rng):
    """Apply a random operation of the image processing to a state."""
    head, size = state.head, state.size
    what = rng.integers(0, 9)
    if what == 8:  # like scans, which also correct frozen errors
        root = rng.normal(size=(6, 6))
        state.update_with_information(POSE, root @ root.T, 1e-3 * rng.normal(size=6))
    elif what == 7:
        state.measure(rng.normal(size=(2, head)), np.arange(head), np.full(2, 1e-3), np.ones(2))
    elif what <= 1:
        columns = rng.permutation(size)[:6]
        state.measure(rng.normal(size=(3, 6)), columns, 1e-3 * rng.normal(size=3), np.full(3, 0.5))
    elif what == 2:  # freeze or release few errors or many
        changed = rng.random(state.tail) < rng.choice([0.05, 0.5])
        state.freeze_tail(np.logical_xor(np.arange(state.tail) >= 10, changed))
    elif what == 3:  # remove some; the last ones take their indices
        removed = rng.random(state.tail) < 0.1
        left = int((~removed).sum())
        holes, movers = np.flatnonzero(removed[:left]), left + np.flatnonzero(~removed[left:])
        state.move_and_truncate(left, head + holes, head + movers)
    elif what == 4:
        add(state, rng)
    elif what == 5:
        at = head + rng.permutation(state.tail)[:2]
        rows = state.covariance_for_rows(at)[at, :size] * 0.5
        state.set_rows(at, rows)
        state.add_process_noise(at, 10.0 * np.eye(2))
    else:
        one = head + int(rng.integers(state.tail))
        others = rng.permutation(np.delete(np.arange(size), one))[:3]
        state.replace_by_sum(one, others, np.array([0.5, 0.3, 0.2]), 0.1)


def add(state, rng):
    """Add new errors that are not frozen."""
    old, is_frozen = state.size, state.is_frozen
    state.reserve(state.tail + 2)
    p = state.covariance_for_rows()
    p[old : old + 2], p[:, old : old + 2] = 0.0, 0.0
    p[old, old], p[old + 1, old + 1] = rng.uniform(0.5, 2.0, 2)
    state.tail += 2
    state.freeze_tail(np.append(is_frozen, [False, False]))


@given(st.integers(0, 10_000))
@settings(max_examples=60)
def test_columns_that_lag_are_brought_up_to_date_bit_for_bit(seed):
    """Read the full covariance of one state after each step, and only rows of the other."""
    rng = np.random.default_rng(seed)
    lags = made(rng, TAIL)
    whole = copy.deepcopy(lags)
    for state in (lags, whole):
        state.freeze_tail(np.arange(TAIL) >= 10)
    for _ in range(25):
        alike((lags, whole), step, rng)
        p = whole.covariance
        assert np.array_equal(p, p.T)
        lags.covariance_for_rows()
        one, other = rng.integers(0, lags.size, (2, 5, 3))
        assert np.array_equal(lags.pair_covariances(one, other), p[one, other])
        active = np.flatnonzero(~np.append(np.zeros(lags.head, bool), lags.is_frozen))
        assert np.array_equal(lags.covariance_for_rows(active)[active, : lags.size], p[active])
    assert np.array_equal(lags.covariance, whole.covariance)
    assert lags.inertial.position == pytest.approx(whole.inertial.position, abs=0.0)


def test_rows_of_errors_that_rest_are_brought_up_to_date_when_asked_for():
    state = made(np.random.default_rng(3), TAIL)
    state.freeze_tail(np.arange(TAIL) >= 10)
    whole = copy.deepcopy(state)
    for each in (state, whole):
        each.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    resting = np.array([state.head + 12])
    behind = state.covariance_for_rows()[resting, : state.size].copy()
    assert not np.array_equal(behind, whole.covariance[resting])
    assert np.array_equal(
        state.covariance_for_rows(resting)[resting, : state.size], whole.covariance[resting]
    )


def test_errors_that_take_others_places_keep_what_they_are():
    rng = np.random.default_rng(5)
    state = made(rng, TAIL)
    is_frozen = rng.random(TAIL) < 0.7
    state.freeze_tail(is_frozen)
    state.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    state.covariance_for_rows()
    before = copy.deepcopy(state).covariance.copy()
    to, source = np.array([2, 5]), np.array([38, 39])
    state.move_and_truncate(38, state.head + to, state.head + source)
    order = np.arange(38)
    order[to] = source
    assert np.array_equal(state.is_frozen, is_frozen[order])
    rows = np.append(np.arange(state.head), state.head + order)
    assert state.size == len(rows)
    assert np.array_equal(state.covariance, before[np.ix_(rows, rows)])


@pytest.mark.parametrize("is_frozen", [False, True], ids=["none rests", "most rest"])
def test_rows_that_are_put_in_are_columns_too(is_frozen):
    state = made(np.random.default_rng(7), TAIL)
    state.freeze_tail(is_frozen & (np.arange(TAIL) >= 10))
    before, at = state.covariance.copy(), state.head + np.array([3, 4])
    rows = np.random.default_rng(8).normal(size=(2, state.size))
    rows[:, at] = np.eye(2)
    state.set_rows(at, rows)
    before[at], before[:, at] = rows, rows.T
    assert np.array_equal(state.covariance, before)


def test_all_errors_may_go_while_columns_lag():
    state = made(np.random.default_rng(12), TAIL)
    state.freeze_tail(np.arange(TAIL) >= 10)
    state.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    state.covariance_for_rows()
    head, none = copy.deepcopy(state).covariance[: state.head, : state.head], np.zeros(0, np.int64)
    state.move_and_truncate(0, none, none)
    assert np.array_equal(state.covariance_for_rows(POSE)[POSE, : state.size], head[POSE])
    assert np.array_equal(state.pair_covariances(POSE, POSE), head[POSE, POSE])
    assert np.array_equal(state.covariance, head)


def test_errors_that_have_just_come_do_not_rest_while_columns_lag():
    state = made(np.random.default_rng(15), TAIL)
    state.freeze_tail(np.arange(TAIL) >= 10)
    state.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    state.reserve(TAIL + 2)
    state.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    state.covariance_for_rows()
    new = state.size + np.arange(2)
    state.tail += 2
    assert not state.covariance_for_rows(new)[new].any()


def test_empty_information_defers_nothing():
    """Deferred updates have the old number of errors, later ones more."""
    state = made(np.random.default_rng(13), TAIL)
    before = state.covariance.copy()
    assert state.update_with_information(POSE, 1e-9 * np.eye(6), np.zeros(6)).dof == 0
    add(state, np.random.default_rng(14))
    for innovation in (0.1, -0.1):
        state.measure(np.eye(1, 3), np.arange(3), np.array([innovation]), np.ones(1))
        state.update_with_information(POSE, np.eye(6), np.zeros(6))
    assert state.covariance[0, 0] < before[0, 0]
    assert state.covariance.shape == (state.size, state.size)


def test_full_update_uses_current_columns():
    """Test with more errors than fit into one block."""
    lags = made(np.random.default_rng(11), 800)
    lags.freeze_tail(np.arange(800) < 780)
    whole = copy.deepcopy(lags)
    for state in (lags, whole):
        state.measure(np.eye(1, 3), np.arange(3), np.array([0.1]), np.ones(1))
    lags.covariance_for_rows()
    assert np.array_equal(whole.covariance, whole.covariance.T)
    for state in (lags, whole):
        state.update_with_information(POSE, np.eye(6), np.full(6, 1e-3))
    assert np.array_equal(lags.covariance, whole.covariance)
