"""Adapt shadow models for horizontal terrain to shadows on a sloping plane."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.typing import Array

Model = TypeVar("Model", ShadowModel, ShapeMixture, ShadowModel | ShapeMixture)


def model_on_plane(model: Model, plane: GroundPlane, sun: Array) -> Model:
    """Return the shadow model for coordinates in which a sloping plane is horizontal.

    In these coordinates the Sun has another elevation above the plane. For a horizontal plane,
    `model` itself is returned.

    Parameters
    ----------
    model
        Model for the Sun elevation above horizontal terrain.
    plane
        Plane on which shadows fall.
    sun
        Direction towards the Sun (3,), ENU.
    """
    if plane.is_horizontal:
        return model
    return model.under(float(np.arcsin(plane.level_direction(sun)[2])))
