"""The cells of the shadow map's matrix: one factor at a time, and all of them at once.

One line of cells goes through each factor from the home cell (5 % cubes told as such, the Sun 20
deg high behind the camera, level ground). Some cells are of rocks that no level of these factors
has, low, tall, long or small, seen along the Sun and aside, by a blurred camera too, and one of
ground with craters, at posts half as far apart. Beside the lines stands an orthogonal array of 25
runs with six factors of five levels: in every two factors each pair of levels comes up once, so
that a cell may be off home in everything. Its columns are a, b, a + b, a + 2 b, a + 3 b, a + 4 b
modulo 5 (Bose 1938).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from lunarsim.scenario import Scenario

SCENARIOS = Path(__file__).parents[1]
SHAPES = ("hemisphere", "ellipsoid", "cube", "irregular", "mixed")
HIRISE = "hirise"

_COVERS = (0.02, 0.03, 0.05, 0.08, 0.15)
_ELEVATIONS = (5.0, 10.0, 20.0, 45.0, 60.0)
# Off the camera's azimuth: the Sun behind it, and round to before it.
_TURNS = (0.0, 45.0, 90.0, 135.0, 180.0)
_RELIEFS = (0.0, 1.0, 2.0, 4.0, 8.0)
# By how many places along the list of shapes the told one is off the true one.
_SHIFTS = (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class Cell:
    """One setting of the experiment.

    Attributes
    ----------
    name
        Of the cell.
    cover, told_cover
        True share k of the ground under rocks, and what the mission is told.
    shape, told_shape
        Likewise.
    elevation, turn
        Of the Sun, deg; 0: it stands behind the camera, 180: before it.
    relief
        Slope of the ground at 1 m, deg RMS, or "hirise" for the measured crop.
    height, slenderness
        True height of the rocks over their width, mean before it is cut off at 1, and length of
        their shorter axis over the longer, mean; None: as rocks have them by default. The mission
        is not told.
    least_diameter
        Of the rocks, m.
    craters
        Of 1 m and more, a square metre in equilibrium; 0: none.
    blur
        Point spread of the camera, 1 sigma, pixels. The mission is told.
    pixels
        Of the camera along each side, over those of the paper's experiment.
    """

    name: str
    cover: float = 0.05
    told_cover: float = 0.05
    shape: str = "cube"
    told_shape: str = "cube"
    elevation: float = 20.0
    turn: float = 0.0
    relief: float | str = 0.0
    height: float | None = None
    slenderness: float | None = None
    least_diameter: float = 0.3
    craters: float = 0.0
    blur: float = 0.6
    pixels: int = 1

    def within_goal(self) -> bool:
        """Tell whether the goal asks the cell for recall.

        Up to 8 % cover, Sun 10 to 45 deg, relief to 4 deg, whatever the rocks are.
        """
        return (
            self.cover <= 0.08
            and 10.0 <= self.elevation <= 45.0
            and self.relief != HIRISE
            and float(self.relief) <= 4.0
        )

    def scenario(self, path: str = "modified") -> Scenario:
        """Return the descent of the paper's experiment over this cell's ground, made small.

        A map of 80 m about the site and two pictures a second: a fifteenth of the time of the whole
        experiment.
        """
        whole = Scenario.load(SCENARIOS / f"shadow_{path}.toml")
        terrain: dict[str, Any] = {"posting_m": 1.0, "rms_slope_deg": self.relief}
        if self.craters > 0.0:
            terrain |= {"posting_m": 0.5, "crater_density": self.craters}
        if self.relief == HIRISE:
            terrain = {
                "kind": "dtm", "posting_m": 0.5, "relief_scale": 0.2, "detail": False,
                "path": str(SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif"),
            }  # fmt: skip
        level = {"burial": [0.0, 0.0]}
        body: dict[str, Any] = {"min_diameter_m": self.least_diameter}
        if self.height is not None:
            body["height_ratio"] = [self.height, 0.1]
        if self.slenderness is not None:
            body["axis_ratio"] = [self.slenderness - 0.1, self.slenderness + 0.1]
        return whole.changed(
            terrain=terrain,
            rocks={"cover": self.cover, "shape": self.shape, **level, **body},
            expected_rocks={"cover": self.told_cover, "shape": self.told_shape, **level},
            sun={"elevation_deg": self.elevation, "azimuth_deg": 225.0 + self.turn},
            mappers={"rocks": {"size_m": 80.0}},
            tasking={"camera": {"rate_hz": 2.0}},
            sensors={
                "camera": {
                    "blur_sigma_px": self.blur,
                    "width": 640 * self.pixels,
                    "height": 480 * self.pixels,
                },
            },
        )


HOME = Cell("home")
# Mixed rocks told to be cubes, under a higher Sun, from the side that shows least of shadows.
ASIDE = Cell("aside", shape="mixed", elevation=30.0, turn=120.0)


def _lines() -> list[Cell]:
    """Return the cells that are off home in one factor."""
    cells = [
        replace(HOME, name=f"cover {c:g}", cover=c, told_cover=c)
        for c in (0.02, 0.03, 0.08, 0.10, 0.15)
    ]
    cells += [replace(HOME, name=f"cover {c:g} told 0.05", cover=c) for c in (0.02, 0.08, 0.15)]
    others = [s for s in SHAPES if s != "cube"]
    cells += [replace(HOME, name=s, shape=s, told_shape=s) for s in others]
    cells += [replace(HOME, name=f"{s} told cube", shape=s) for s in others]
    cells += [replace(HOME, name=f"cube told {s}", told_shape=s) for s in others]
    cells += [
        replace(HOME, name=f"sun {e:g}", elevation=e) for e in (5.0, 10.0, 15.0, 30.0, 45.0, 60.0)
    ]
    cells += [replace(HOME, name=f"sun turned {t:g}", turn=t) for t in (45.0, 90.0, 135.0, 180.0)]
    cells += [replace(HOME, name=f"relief {r:g}", relief=r) for r in (1.0, 2.0, 4.0, 6.0, 8.0)]
    cells += [replace(HOME, name=HIRISE, relief=HIRISE)]
    low_to_high = (0.3, 0.7, 0.85, 1.0)
    cells += [
        replace(HOME, name=f"height {h:g} told cube", shape="irregular", height=h)
        for h in low_to_high
    ]
    return [
        *cells,
        # As measured: see `lunarsim.rocks.field.RockModel`.
        replace(HOME, name="fragments told cube", shape="irregular", height=0.54, slenderness=0.7),
        replace(HOME, name="long told cube", shape="ellipsoid", slenderness=0.5),
        replace(HOME, name="rocks from 0.15 m", least_diameter=0.15),
        replace(HOME, name="craters", relief=1.0, craters=0.02),
        replace(ASIDE, name="aside"),
        replace(ASIDE, name="aside, low", height=0.35),
        replace(ASIDE, name="aside, low and long", height=0.35, slenderness=0.6),
        replace(ASIDE, name="aside, blurred", blur=0.9),
    ]


def _array() -> list[Cell]:
    """Return the 25 runs of the orthogonal array."""
    cells = []
    for a, b in product(range(5), repeat=2):
        cover, shape, shift, sun, turn, relief = (
            a, b, (a + b) % 5, (a + 2 * b) % 5, (a + 3 * b) % 5, (a + 4 * b) % 5,
        )  # fmt: skip
        cells.append(
            Cell(
                f"array {a}{b}",
                cover=_COVERS[cover],
                told_cover=_COVERS[cover],
                shape=SHAPES[shape],
                told_shape=SHAPES[(shape + _SHIFTS[shift]) % 5],
                elevation=_ELEVATIONS[sun],
                turn=_TURNS[turn],
                relief=_RELIEFS[relief],
            )
        )
    return cells


# What a camera of 640 x 480 pixels cannot tell at 50 m.
SHORT_OF = ("rocks from 0.15 m", "array 03", "array 04", "array 11", "array 30")


def _sharper(cells: list[Cell]) -> list[Cell]:
    """Return those of the cells of which a camera tells too little with half as large pixels."""
    return [replace(c, name=f"{c.name}, sharp", pixels=2) for c in cells if c.name in SHORT_OF]


CELLS = (HOME, *_lines(), *_array(), *_sharper([*_lines(), *_array()]))
