"""A descent over known rocks with simulated measurements: the filter's truth for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_rotate, quat_to_matrix
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.measurement_models import update_with_range
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.sensors.camera import Camera

GRAVITY = 1.622
ERRORS = StartSigmas(2.0, 0.1, 2e-3)
# Errors that the filter models in full: no scale factor, no quantisation.
GYROSCOPES = TriadErrors(5e-5, 1e-4, 1e-6)
ACCELEROMETERS = TriadErrors(3e-3, 1e-3, 1e-5)
CAMERA = Camera()


class Flight:
    """A straight powered descent past the origin, and a filter that follows it."""

    def __init__(self, rng, rocks=12, ground=None):
        self.rng = rng
        self.position = np.array([-150.0, 40.0, 260.0])
        self.velocity = np.array([9.0, -2.0, -9.0])
        self.attitude = quat_from_rotation_vector([0.05, 0.2, 0.3])
        self.rate = np.array([0.004, -0.01, 0.003])
        self.force = np.array([0.05, -0.02, 1.7])
        self.xy = rng.uniform(-40.0, 40.0, (rocks, 2))
        self.radius = rng.uniform(0.3, 1.0, rocks)
        self.height = np.zeros(rocks)
        self.bias_a = ACCELEROMETERS.bias * rng.standard_normal(3)
        self.bias_g = GYROSCOPES.bias * rng.standard_normal(3)
        error = rng.standard_normal((3, 3))
        start = StrapdownState(
            self.position + ERRORS.position * error[0],
            self.velocity + ERRORS.velocity * error[1],
            quat_multiply(self.attitude, quat_from_rotation_vector(ERRORS.attitude * error[2])),
            GRAVITY,
            gyroscopes=GYROSCOPES,
            accelerometers=ACCELEROMETERS,
        )
        self.filter = RockFilter.of(start, ERRORS, terrain_prior=ground, capacity=4)
        self.pixel_sigma = 0.8
        self.seen = rocks  # by the last image
        self.resting: np.random.Generator | None = None  # draws which rocks an image leaves alone
        self.time = 0.0

    def draw_heights(self, sigma, relief):
        """Draw rocks' heights: of a level under the lander, and as differences grow from there."""
        places = np.vstack((self.position[:2], self.xy))
        away = np.linalg.norm(places[:, None] - places[None], axis=-1)
        # Of differences from the ground under the lander; 5 cm are each place's own.
        rise = 0.5 * 10.0 * relief**2 * (away[1:, :1] + away[:1, 1:] - away[1:, 1:])
        n = len(self.xy)
        drawn = np.linalg.cholesky(rise + 0.05**2 * (np.eye(n) + 1.0)) @ self.rng.normal(size=n)
        self.height = sigma * self.rng.normal() + drawn

    def advance(self, samples=10, step=0.01):
        """Move truth and filter by as many inertial samples."""
        n = samples
        white = self.rng.standard_normal((4, n, 3)) * np.sqrt(step)
        # The rate is constant: attitudes in the middle of each step, and at the end of the last.
        passed = step * np.append(np.arange(n) + 0.5, n)
        turned = quat_from_rotation_vector(passed[:, None] * self.rate)
        attitudes = quat_multiply(self.attitude[None], turned)
        a = quat_rotate(attitudes[:-1], self.force) + np.array([0.0, 0.0, -GRAVITY])
        velocities = self.velocity + step * np.cumsum(a, axis=0)
        self.position = self.position + step * (velocities - 0.5 * step * a).sum(axis=0)
        self.velocity, self.attitude = velocities[-1], attitudes[-1]
        bias_a = self.bias_a + ACCELEROMETERS.bias_walk * np.cumsum(white[2], axis=0)
        bias_g = self.bias_g + GYROSCOPES.bias_walk * np.cumsum(white[3], axis=0)
        self.bias_a, self.bias_g = bias_a[-1], bias_g[-1]
        angle = step * (self.rate + bias_g) + GYROSCOPES.random_walk * white[0]
        velocity = step * (self.force + bias_a) + ACCELEROMETERS.random_walk * white[1]
        self.filter.propagate(angle, velocity)
        self.time += n * step

    def camera(self):
        """A camera that the true gimbal points at the origin."""
        return replace(CAMERA, mount=gimbal_mount(self.attitude, -self.position))

    def look(self, camera):
        """Return noisy pixels (n, 2), radii (n,) and their covariances."""
        ground = np.column_stack((self.xy, self.height))
        seen = (ground - self.position) @ quat_to_matrix(self.attitude) @ camera.mount
        tangent = seen[:, :2] / seen[:, 2:]
        pixel = tangent * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        pixel = pixel + self.pixel_sigma * self.rng.standard_normal(pixel.shape)
        covariance = np.tile(self.pixel_sigma**2 * np.eye(2), (len(pixel), 1, 1))
        sigma = 0.2 * np.ones(len(pixel))
        radius = self.radius + sigma * self.rng.standard_normal(len(pixel))
        return pixel, covariance, radius, sigma**2

    def ground_of(self, pixel, camera):
        """Return where the filter takes pixels to lie on the ground at 0 m (n, 3)."""
        s = self.filter.inertial
        tangent = (pixel - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        ray = np.column_stack((tangent, np.ones(len(pixel))))
        ray = ray @ (quat_to_matrix(s.attitude) @ camera.mount).T
        return s.position + ray * (-s.position[2] / ray[:, 2:])

    def image(self):
        """Take in one image: new rocks at the first, an update at the others; return the NIS."""
        camera = self.camera()
        pixel, covariance, radius, variance = self.look(camera)
        if self.filter.count == 0:
            self.filter.add(camera, self.ground_of(pixel, camera), covariance, radius, variance)
            return None
        sight = self.filter.project_rocks(camera)
        index = np.arange(len(pixel))
        if self.resting is not None:
            rests = self.resting.random(len(pixel)) < 0.7
            self.filter.freeze(rests)
            index = np.flatnonzero(~rests)
        self.seen = len(index)
        return self.filter.update_rocks(
            index, sight, pixel[index], covariance[index], radius[index], variance[index]
        ).nis

    def range(self, sigma=1.0):
        """Take in an altimeter reading; return the NIS."""
        down = quat_to_matrix(self.attitude)[2] @ np.array([0.0, 0.0, -1.0])
        reading = -self.position[2] / down + sigma * self.rng.standard_normal()
        return update_with_range(
            self.filter.state,
            reading,
            sigma,
            (0.0, 0.0, -1.0),
            self.filter.terrain_height_below,
            gate=16.0,
        ).nis

    def error(self):
        """Return true minus estimated state in the order of the covariance."""
        from lunarsim.frames import quat_conjugate, quat_to_rotation_vector

        s = self.filter.inertial
        between = quat_multiply(quat_conjugate(s.attitude), self.attitude)
        bias_a, bias_g = s.biases
        return np.concatenate(
            (
                self.position - s.position,
                self.velocity - s.velocity,
                self.bias_a - bias_a,
                quat_to_rotation_vector(between),
                self.bias_g - bias_g,
                (np.column_stack((self.xy, self.height)) - self.filter.xyz).ravel(),
            )
        )
