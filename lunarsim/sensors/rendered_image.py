"""Images produced by the renderer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RenderedImage:
    """Rendered image: radiance factor and, if requested, geometry of every pixel.

    Attributes
    ----------
    radiance
        Radiance factor I/F (height, width), float32; 0 for the sky.
    range
        Distance along the pixel's ray (height, width), m; NaN for the sky; None unless requested.
    normal
        Unit surface normal (height, width, 3), ENU; NaN for the sky; None unless requested.
    identity
        Index of the visible rock (height, width); -1 for relief, -2 for the sky; None unless
        requested.
    """

    radiance: NDArray[np.float32]
    range: NDArray[np.float32] | None = None
    normal: NDArray[np.float32] | None = None
    identity: NDArray[np.int32] | None = None
