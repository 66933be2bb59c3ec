"""Edge slopes and sums of both sides against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.perception import _image_quality_kernels as kernels


def test_slopes_equal_plain_loops():
    rng = np.random.default_rng(1)
    image = rng.random((40, 50)).astype(np.float32)
    patch = np.zeros((40, 50), np.uint16)
    patch[8:15, 9:20], patch[20:33, 30:41] = 1, 2
    # Too near the border, on each side.
    patch[1:3, 1:3], patch[20:30, 47:49], patch[37:39, 5:15] = 3, 3, 3
    # With one row or column that is just not.
    patch[8:14, 45:49], patch[35:39, 30:40] = 4, 5
    found = kernels.edge_slopes(image, patch, 5, 1, 0.3)
    expected = np.zeros((6, 5))
    for i in range(4, 36):
        for j in range(4, 46):
            around = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
            # Patches whose rim this pixel is, or lies just outside of.
            owners = {int(patch[i + a, j + b]) for a, b in around} - {0}
            for k in owners:
                rim = patch[i, j] == k and any(patch[i + a, j + b] != k for a, b in around)
                outside = patch[i, j] != k and any(
                    patch[i + a, j + b] == k and 4 <= i + a < 36 and 4 <= j + b < 46
                    for a, b in around[1:]
                )
                if not (rim or outside):
                    continue
                window = image[i - 3 : i + 4, j - 3 : j + 4].astype(float)
                size = window.max() - window.min()
                gu = 0.5 * (float(image[i, j + 1]) - float(image[i, j - 1]))
                gv = 0.5 * (float(image[i + 1, j]) - float(image[i - 1, j]))
                if size < 0.3 or np.hypot(gu, gv) <= 0.02:
                    continue
                slopes = [abs(gu), abs(gu + gv) / np.sqrt(2), abs(gv), abs(gv - gu) / np.sqrt(2)]
                lines = window[3], np.diag(window), window[:, 3], np.diag(window[:, ::-1])
                ranges = np.array([max(np.ptp(line), 0.5 * size) for line in lines])
                told = np.where(ranges >= 0.3, slopes / ranges, 0.0)
                expected[k] = np.maximum(expected[k], [*told, np.hypot(gu, gv) / size])
    assert found == pytest.approx(expected, rel=1e-5)
    assert (found[[1, 2, 4, 5]] > 0.0).all() and (found[3] == 0.0).all()
    some = kernels.edge_slopes(image, patch, 5, 2, 0.3)
    assert np.array_equal(some[2::2], found[2::2]) and not some[[0, 1, 3, 5]].any()


def test_sides_equal_plain_sums():
    rng = np.random.default_rng(2)
    image = (0.5 + rng.random((30, 36))).astype(np.float32)
    patch, ring = np.zeros((2, 30, 36), np.uint16)
    patch[5:12, 6:14], patch[15:25, 20:30] = 1, 2
    ring[3:14, 4:16], ring[13:27, 18:32] = 1, 2
    found = kernels.sum_dark_and_bright(image, patch, ring, 2, 0.1)
    v, u = np.mgrid[:30, :36]
    for k in (1, 2):
        beside = (ring == k) & (patch == 0)
        more = np.where(beside, np.clip(image.astype(float) - 1.1, 0.0, 1.0), 0.0)
        own = patch == k
        sums = [
            more.sum(),
            (more * u).sum(),
            (more * v).sum(),
            own.sum(),
            u[own].sum(),
            v[own].sum(),
        ]
        assert found[k] == pytest.approx(sums, rel=1e-5)
