"""Render a descent by kernels with its hazard map and candidate sites."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim_envs.descent.plane_view import SIDE, Image, PlaneView
from lunarsim_envs.sites.batch import SiteDescentBatch

_UNSEEN, _WORDS, _EDGE = (60, 60, 66), (235, 235, 235), (16, 18, 24)
_SITE, _LANDER, _REACHED, _OUT_OF_REACH = (255, 64, 64), (255, 255, 255), (0, 220, 255), (150,) * 3
# Number of p_safe levels of the colour bar; height of the legend, pixels.
_LEVELS, _LEGEND = 110, 26


def draw_hazard_map(lanes: SiteDescentBatch, lane: int) -> Image:
    """Return an RGB image (440, 440, 3) of the hazard map of one lander, north up.

    Colours are p_safe from 0 (dark) to 1 (bright), grey cells are not observed. Rings are candidate
    sites, grey ones out of reach; the cross is the current site and the triangle the lander.
    """
    maps, found = lanes.maps, lanes.candidates
    p, seen = maps.p[lane][::-1], maps.seen[lane][::-1]
    levels = np.round(255.0 * np.clip(np.nan_to_num(p), 0.0, 1.0)).astype(np.uint8)
    colours = cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_CIVIDIS), cv2.COLOR_BGR2RGB)
    colours = np.where(seen[..., None], colours, np.array(_UNSEEN, np.uint8))
    rows, cols = seen.shape
    scale = (SIDE - _LEGEND) / max(rows, cols)
    size = max(round(cols * scale), 1), max(round(rows * scale), 1)
    image = np.full((SIDE, SIDE, 3), _EDGE, np.uint8)
    image[_LEGEND : _LEGEND + size[1], : size[0]] = cv2.resize(
        colours, size, interpolation=cv2.INTER_NEAREST
    )
    corner, posting = maps.corner[lane], maps.posting

    def pixel(position: NDArray[np.float64]) -> tuple[int, int]:
        cell = (position[:2] - corner) / posting + 0.5
        east, north = np.clip(cell, -2.0 * cols, 3.0 * cols) * scale
        return round(float(east)), round(_LEGEND + size[1] - float(north))

    for i in range(int(found.number[lane])):
        reached = np.isfinite(found.propellant[lane, i])
        colour = _REACHED if reached else _OUT_OF_REACH
        cv2.circle(image, pixel(found.position[lane, i]), 5, colour, 1)
    site = pixel(lanes.guidance.site[lane])
    cv2.drawMarker(image, site, _SITE, cv2.MARKER_CROSS, 16, 2, cv2.LINE_AA)
    place = pixel(lanes.estimated_state[0][lane])
    cv2.drawMarker(image, place, _LANDER, cv2.MARKER_TRIANGLE_UP, 12, 2, cv2.LINE_AA)
    _write_legend(image, f"p_safe, {cols * posting:.0f} m across")
    return image


def _write_legend(image: Image, text: str) -> None:
    """Draw a title and a colour bar of p_safe at the top of a map image."""
    image[:_LEGEND] = _EDGE
    bar = np.linspace(0, 255, _LEVELS).astype(np.uint8)[None].repeat(10, axis=0)
    left = SIDE - _LEVELS - 24
    image[8:18, left : left + _LEVELS] = cv2.cvtColor(
        cv2.applyColorMap(bar, cv2.COLORMAP_CIVIDIS), cv2.COLOR_BGR2RGB
    )
    font = cv2.FONT_HERSHEY_SIMPLEX
    for words, where in ((text, 8), ("0", left - 14), ("1", left + _LEVELS + 6)):
        cv2.putText(image, words, (where, 18), font, 0.42, _WORDS, 1, cv2.LINE_AA)


class MapView(PlaneView):
    """Draw one lander of a batch as `PlaneView`, with its hazard map to the right."""

    def __init__(self, lanes: SiteDescentBatch, lane: int = 0) -> None:
        super().__init__(lanes, lane)
        self._sites = lanes

    def draw(self) -> Image:
        """Return an RGB image of the current state (440, 1080, 3)."""
        return np.hstack((super().draw(), draw_hazard_map(self._sites, self._lane)))
