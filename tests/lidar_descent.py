"""A straight descent with a navigator on board that scans the ground, on a map or without."""

from __future__ import annotations

from functools import cache
from typing import ClassVar

import numpy as np

from lunarsim.evaluation.consistency import normalised_squared_error
from lunarsim.frames import (
    attitude_from_thrust,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_to_rotation_vector,
)
from lunarsim.grid import Grid
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.sensors.imu import Imu
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world.survey import simulate_survey

LIDAR = FlashLidar(128, 128, 0.03, 5e-5)
START, VELOCITY = np.array([-220.0, 0.0, 140.0]), np.array([5.0, 0.0, -3.0])
UPRIGHT = attitude_from_thrust([0.0, 0.0, 1.0], np.pi / 2)
KEEP = np.r_[0:3, 6:9]


class Surveyed:
    """The terrain of a world as `simulate_survey` reads it; all maps of one world share one "
    "raster."""

    known: ClassVar[dict[int, Surveyed]] = {}

    def __init__(self, world):
        self.world = world  # kept, so that no other world gets its identity
        self.raster = cache(world.terrain.raster)

    @classmethod
    def of(cls, world):
        return cls.known.setdefault(id(world), cls(world))


def mapped(world, rng, **options):
    grid = Grid.centred((0.0, 0.0), 240.0, 0.5)
    return simulate_survey(Surveyed.of(world), grid, rng, sigma=0.1, **options)


class Descent:
    """A straight descent with a filter on board."""

    def __init__(self, world, seed, prior=None, errors=None, lidar=LIDAR):
        self.rng = np.random.default_rng(seed)
        self.world = world
        errors = errors or StartSigmas(15.0, 0.1, np.deg2rad(0.3))
        drawn = self.rng.standard_normal((3, 3))
        self.inertial = StrapdownState(
            START + errors.position * drawn[0],
            VELOCITY + errors.velocity * drawn[1],
            quat_multiply(UPRIGHT, quat_from_rotation_vector(errors.attitude * drawn[2])),
            9.81,
        )
        prior = prior if prior is not None else mapped(world, self.rng)
        self.lidar = lidar.build(self.rng, 0.01)
        self.filter = Navigator(
            self.inertial, errors, prior, instruments={"flash": lidar.calibration()}
        )
        self.imu = Imu(self.rng)
        self.time = 0.0

    @property
    def position(self):
        return START + VELOCITY * self.time

    def estimate(self):
        return self.filter.estimate_in_site(self.time, 1.0)

    def error(self):
        """Of position and of attitude (small rotation, ENU), both in the site frame."""
        found = self.estimate()
        turn = quat_multiply(UPRIGHT, quat_conjugate(found.attitude))
        return np.concatenate((self.position - found.position, quat_to_rotation_vector(turn)))

    def nees(self):
        p = self.estimate().covariance
        return normalised_squared_error(self.error(), p[np.ix_(KEEP, KEEP)])

    def scan(self, aim):
        state = State(self.position, VELOCITY, UPRIGHT, np.zeros(3), 1.0)
        found = self.estimate()
        mount = gimbal_mount(found.attitude, aim - found.position)
        return self.lidar.measure(self.world, state, self.time, self.rng, mount)

    def fly(self, seconds, aim=None, scans=True):
        for _ in range(round(seconds / 0.1)):
            if scans:
                angle = 2.0 * np.pi * self.time / 3.0
                spot = np.array([25.0 * np.cos(angle), 25.0 * np.sin(angle), 0.0])
                self.filter.take("flash", self.scan(spot if aim is None else aim), self.time)
            force = quat_rotate(quat_conjugate(UPRIGHT), [0.0, 0.0, 9.81])
            self.filter.propagate(*self.imu.measure(np.zeros((10, 3)), np.tile(force, (10, 1))))
            self.time += 0.1
        return self


def names(descent):
    return [event.name for event in descent.filter.events]
