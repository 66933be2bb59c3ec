"""Models of shadows on level ground, for shadows that fall along a plane."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture

Array = NDArray[np.float64]
Model = TypeVar("Model", ShadowModel, ShapeMixture, ShadowModel | ShapeMixture)


def model_on_plane(model: Model, plane: GroundPlane, sun: Array) -> Model:
    """Return the model of the same rocks as they are seen in coordinates that level a plane.

    Parameters
    ----------
    model
        Under the Sun's elevation above level ground.
    plane
        Along which shadows fall.
    sun
        Direction towards it (3,), ENU.
    """
    if plane.level:
        return model
    return model.under(float(np.arcsin(plane.direction(sun)[2])))
