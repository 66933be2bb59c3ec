"""Render selected environments of a vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lunarsim.errors import InputError
from lunarsim.typing import BoolArray
from lunarsim_envs.arguments import checked_int
from lunarsim_envs.descent.plane_view import Image, PlaneView


class LaneRenderer:
    """Draw the frames of some environments of a batch.

    Parameters
    ----------
    render_mode
        ``"rgb_array"``, or None for no frames.
    rendered
        Indices of the environments to draw.
    lanes
        Landers of all environments.
    view
        Class that draws one of them.

    Raises
    ------
    InputError
        If the mode is another one, or an index is not that of an environment.
    """

    def __init__(
        self, render_mode: Any, rendered: Sequence[int], lanes: Any, view: Any = PlaneView
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError("render_mode", render_mode, "must be 'rgb_array' or None")
        if not isinstance(rendered, Sequence) or isinstance(rendered, str):
            raise InputError("rendered", rendered, "must be a list of indices of environments")
        indices = [checked_int(f"rendered[{i}]", one, 0) for i, one in enumerate(rendered)]
        for i, one in enumerate(indices):
            if one >= lanes.count:
                raise InputError(f"rendered[{i}]", one, f"must be below num_envs ({lanes.count})")
        if not indices or len(set(indices)) < len(indices):
            raise InputError("rendered", indices, "must be one or more indices, each given once")
        self._views: dict[int, PlaneView] = {}
        if render_mode is not None:
            self._views = {one: view(lanes, one) for one in indices}

    @property
    def has_views(self) -> bool:
        """Whether frames are drawn."""
        return bool(self._views)

    def begin(self, mask: BoolArray) -> None:
        """Start the drawn paths of the environments of `mask` (n,)."""
        for lane, view in self._views.items():
            if mask[lane]:
                view.begin()

    def add_positions(self, mask: BoolArray) -> None:
        """Append the positions of the environments of `mask` (n,) to their drawn paths."""
        for lane, view in self._views.items():
            if mask[lane]:
                view.note()

    def draw(self) -> tuple[Image, ...] | None:
        """Return an RGB image of each selected environment; None without a render mode."""
        return tuple(view.draw() for view in self._views.values()) if self._views else None
