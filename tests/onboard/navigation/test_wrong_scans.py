"""Test scans that contradict the map or the scanner's specification during a lock."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.world import World
from lunarsim.world.terrain import hazard_field
from tests.lidar_descent import KEEP, LIDAR, VELOCITY, Descent, mapped, names

FROM = 4.0


@pytest.fixture(scope="module")
def ground():
    world = World(hazard_field(np.random.default_rng(4), surround=280.0, posting=0.5), 9.81)
    return world, mapped(world, np.random.default_rng(1))


@pytest.fixture(scope="module")
def begin(ground):
    """Return a function that gives copies of descents of 4 s, each flown only once."""
    world, prior = ground
    known = {}

    def copied(seed, lidar=LIDAR):
        key = seed, repr(lidar)
        if key not in known:
            descent, worst = Descent(world, seed, prior, lidar=lidar), 0.0
            for _ in range(round(FROM)):
                worst = further(descent, worst)
            known[key] = descent, worst
        return copy.deepcopy(known[key], {id(world): world, id(prior): prior})

    return copied


def further(descent, worst):
    """Fly 1 s; return the larger of an error and that of the descent, unless it is lost."""
    descent.fly(1.0)
    return worst if descent.filter.lost else max(worst, descent_off(descent))


def flown(begin, seed, change, seconds, lidar=LIDAR):
    """Fly with modified scans from 4 s on; return the descent and its maximum errors.

    Of position and attitude, in deviations, at the end of each second while not called lost.
    """
    descent, worst = begin(seed, lidar)
    honest = descent.filter.take

    def take(sensor, scan, time):
        honest(sensor, scan if time < FROM else change(scan), time)

    descent.filter.take = take
    for _ in range(seconds - round(FROM)):
        worst = further(descent, worst)
    return descent, worst


def descent_off(descent):
    """Return the maximum error of position or attitude, in sigmas."""
    sigma = np.sqrt(np.diag(descent.estimate().covariance))[KEEP]
    return float((np.abs(descent.error()) / sigma).max())


def velocity_off(descent):
    """Return the maximum error of velocity, in sigmas."""
    found = descent.estimate()
    sigma = np.sqrt(np.diag(found.covariance)[3:6])
    return float((np.abs(VELOCITY - found.velocity) / sigma).max())


@pytest.mark.parametrize(("seed", "off"), [(11, 0.4), (11, 1.0), (12, 4.0)])
def test_range_bias_is_attributed_to_scanner(begin, seed, off):
    """With a bias above six specified sigmas, the scanner is out of specification."""
    descent, worst = flown(begin, seed, lambda s: replace(s, range=s.range + off), 8)
    assert names(descent)[:2] == ["lock", "covariance-inflated"]
    assert descent.filter.lost is (off > 0.6)
    assert descent.filter.locked
    assert worst < 4.0 and descent_off(descent) < 4.0 and velocity_off(descent) < 4.0
    bias = descent.filter.state.value("lidar flash")[0]
    assert abs(bias) == pytest.approx(off, abs=0.3)


def test_undetected_rotation_is_not_attributed_to_boresight(begin):
    """The tilt is 1.1 deg: the boresight is released but cannot explain it."""
    descent, _ = begin(11)
    honest = descent.filter.propagate

    def turning(angle, velocity):
        off = np.array([2e-4, 0.0, 0.0]) if descent.time < FROM + 1.0 else np.zeros(3)
        honest(angle + off, velocity)

    descent.filter.propagate = turning
    descent.fly(5.0)
    assert descent_off(descent) > 5.0
    assert descent.filter.lost and names(descent)[-1] == "lost"
    assert descent.filter.events[-1].details["measurement"] == "scanner"


def test_impossible_scanner_error_loses_navigation(begin):
    """The base of the gimbal rotates: no range, boresight or latency error."""
    turn = quat_to_matrix(quat_from_rotation_vector([np.deg2rad(1.0), 0.0, 0.0]))
    descent, worst = flown(begin, 11, lambda s: replace(s, mount=turn @ s.mount), 10)
    assert names(descent)[-1] == "lost"
    assert descent.filter.lost and worst < 4.0


def test_spikes_are_removed_before_registration(begin):
    rng = np.random.default_rng(0)

    def flecks(scan):
        far = rng.random(len(scan.range)) < 0.1
        return replace(scan, range=np.where(far, scan.range + 5.0, scan.range))

    descent, worst = flown(begin, 11, flecks, 7)
    assert names(descent) == ["lock"]
    assert worst < 4.0 and velocity_off(descent) < 4.0


def test_excessive_noise_is_ignored(begin):
    rng = np.random.default_rng(0)

    def noise(scan):
        return replace(scan, range=scan.range + 0.5 * rng.standard_normal(len(scan.range)))

    descent, worst = flown(begin, 11, noise, 7)
    assert names(descent) == ["lock", "scans-rejected"]
    assert worst < 4.0 and velocity_off(descent) < 4.0
    told = descent.filter.events[-1].details
    assert told["noise"] == pytest.approx(0.5, rel=0.1)
    descent.filter.take = type(descent.filter).take.__get__(descent.filter)
    descent.fly(0.2)
    assert names(descent)[-1] == "scans-accepted"


def test_excessive_specified_noise_is_ignored(begin):
    """Noise of 0.3 m from the start: noise slopes once biased the velocity by 12 sigmas."""
    noisy = replace(LIDAR, noise_ratio=1.2e-3)
    descent, worst = flown(begin, 11, lambda scan: scan, 6, noisy)
    assert names(descent) == ["scans-rejected"]
    assert worst < 4.0 and velocity_off(descent) < 4.0
