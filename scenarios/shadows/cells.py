"""Define the cells (test cases) of the shadow map matrix.

One line of cells varies each factor from the home cell (5 % cubes with correct prior, Sun at 20 deg
behind the camera, horizontal terrain). Further cells have rocks outside these factor levels (low,
tall, long or small, seen along the Sun and from the side, also with a blurred camera), or cratered
terrain with half the grid spacing. In addition there is an orthogonal array of 25 runs with six
factors of five levels: for every two factors, each pair of levels occurs once, so that a cell can
differ (Bose 1938).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from lunarsim import Scenario

SCENARIOS = Path(__file__).parents[1]
SHAPES = ("hemisphere", "ellipsoid", "cube", "irregular", "mixed")
HIRISE = "hirise"

_COVERS = (0.02, 0.03, 0.05, 0.08, 0.15)
_ELEVATIONS = (5.0, 10.0, 20.0, 45.0, 60.0)
# Sun azimuth relative to the camera: from behind the camera round to in front of it.
_TURNS = (0.0, 45.0, 90.0, 135.0, 180.0)
_RELIEFS = (0.0, 1.0, 2.0, 4.0, 8.0)
# Offset of the expected shape from the true one in the list of shapes.
_SHIFTS = (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class ShadowCell:
    """One test case of the shadow map study: rocks, Sun, terrain and camera.

    Attributes
    ----------
    name
        Name of the cell.
    cover, expected_cover
        True and expected rock cover k (fraction).
    shape, expected_shape
        True and expected rock shape.
    elevation, turn
        Sun elevation, and Sun azimuth relative to the direction behind the camera (180: in front
        of it), deg.
    relief
        RMS slope at 1 m, deg, or "hirise" for the measured crop.
    height, slenderness
        True mean height / width of the rocks (before the cut-off at 1), and mean ratio of their
        shorter to their longer axis; None: default. The mission does not know them.
    min_diameter
        Minimum rock diameter, m.
    craters
        Equilibrium density of craters of 1 m and more, 1/m^2; 0: none.
    blur
        Point spread of the camera, 1 sigma, pixels; the mission knows it.
    pixels
        Factor on the camera pixels per side relative to the experiment of the shadow EKF paper.
    """

    name: str
    cover: float = 0.05
    expected_cover: float = 0.05
    shape: str = "cube"
    expected_shape: str = "cube"
    elevation: float = 20.0
    turn: float = 0.0
    relief: float | str = 0.0
    height: float | None = None
    slenderness: float | None = None
    min_diameter: float = 0.3
    craters: float = 0.0
    blur: float = 0.6
    pixels: int = 1

    def recall_goal_applies(self) -> bool:
        """Return whether the recall requirement applies to this test case.

        It applies to a cover up to 8 %, Sun elevations of 10 to 45 deg and relief up to 4 deg, for
        all rocks.
        """
        return (
            self.cover <= 0.08
            and 10.0 <= self.elevation <= 45.0
            and self.relief != HIRISE
            and float(self.relief) <= 4.0
        )

    def scenario(self, path: str = "modified") -> Scenario:
        """Return the scenario of this test case: a short descent of the shadow EKF paper.

        `path` is the descent, "nominal" or "modified". The map is 80 m wide and the camera takes
        two images per second, which needs a fifteenth of the time of the complete experiment.
        """
        base = Scenario.load(SCENARIOS / f"shadow_{path}.toml")
        terrain: dict[str, Any] = {"posting_m": 1.0, "rms_slope_deg": self.relief}
        if self.craters > 0.0:
            terrain |= {"posting_m": 0.5, "crater_density": self.craters}
        if self.relief == HIRISE:
            terrain = {
                "kind": "dtm", "posting_m": 0.5, "relief_scale": 0.2, "detail": False,
                "path": str(SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif"),
            }  # fmt: skip
        level = {"burial": [0.0, 0.0]}
        body: dict[str, Any] = {"min_diameter_m": self.min_diameter}
        if self.height is not None:
            body["height_ratio"] = [self.height, 0.1]
        if self.slenderness is not None:
            body["axis_ratio"] = [self.slenderness - 0.1, self.slenderness + 0.1]
        return base.changed(
            terrain=terrain,
            rocks={"cover": self.cover, "shape": self.shape, **level, **body},
            expected_rocks={"cover": self.expected_cover, "shape": self.expected_shape, **level},
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


HOME = ShadowCell("home")
# Mixed rocks with cubes expected, under a higher Sun. The visible shadow area is minimal from this
# side.
ASIDE = ShadowCell("aside", shape="mixed", elevation=30.0, turn=120.0)


def _one_factor_cells() -> list[ShadowCell]:
    """Return the test cases that differ from the reference case `HOME` in one factor."""
    cells = [
        replace(HOME, name=f"cover {c:g}", cover=c, expected_cover=c)
        for c in (0.02, 0.03, 0.08, 0.10, 0.15)
    ]
    cells += [
        replace(HOME, name=f"cover {c:g} (expected 0.05)", cover=c) for c in (0.02, 0.08, 0.15)
    ]
    others = [s for s in SHAPES if s != "cube"]
    cells += [replace(HOME, name=s, shape=s, expected_shape=s) for s in others]
    cells += [replace(HOME, name=f"{s} (expected cube)", shape=s) for s in others]
    cells += [replace(HOME, name=f"cube (expected {s})", expected_shape=s) for s in others]
    cells += [
        replace(HOME, name=f"sun {e:g}", elevation=e) for e in (5.0, 10.0, 15.0, 30.0, 45.0, 60.0)
    ]
    cells += [replace(HOME, name=f"sun turned {t:g}", turn=t) for t in (45.0, 90.0, 135.0, 180.0)]
    cells += [replace(HOME, name=f"relief {r:g}", relief=r) for r in (1.0, 2.0, 4.0, 6.0, 8.0)]
    cells += [replace(HOME, name=HIRISE, relief=HIRISE)]
    low_to_high = (0.3, 0.7, 0.85, 1.0)
    cells += [
        replace(HOME, name=f"height {h:g} (expected cube)", shape="irregular", height=h)
        for h in low_to_high
    ]
    return [
        *cells,
        # As measured, see `lunarsim.rocks.field.RockModel`.
        replace(
            HOME, name="fragments (expected cube)", shape="irregular", height=0.54, slenderness=0.7
        ),
        replace(HOME, name="long (expected cube)", shape="ellipsoid", slenderness=0.5),
        replace(HOME, name="rocks from 0.15 m", min_diameter=0.15),
        replace(HOME, name="craters", relief=1.0, craters=0.02),
        replace(ASIDE, name="aside"),
        replace(ASIDE, name="aside, low", height=0.35),
        replace(ASIDE, name="aside, low and long", height=0.35, slenderness=0.6),
        replace(ASIDE, name="aside, blurred", blur=0.9),
    ]


def _orthogonal_array_cells() -> list[ShadowCell]:
    """Return 25 test cases, an orthogonal array of six factors with five levels."""
    cells = []
    for a, b in product(range(5), repeat=2):
        cover, shape, shift, sun, turn, relief = (
            a, b, (a + b) % 5, (a + 2 * b) % 5, (a + 3 * b) % 5, (a + 4 * b) % 5,
        )  # fmt: skip
        cells.append(
            ShadowCell(
                f"array {a}{b}",
                cover=_COVERS[cover],
                expected_cover=_COVERS[cover],
                shape=SHAPES[shape],
                expected_shape=SHAPES[(shape + _SHIFTS[shift]) % 5],
                elevation=_ELEVATIONS[sun],
                turn=_TURNS[turn],
                relief=_RELIEFS[relief],
            )
        )
    return cells


# Cells that a camera of 640 x 480 pixels cannot resolve at 50 m.
UNRESOLVED = ("rocks from 0.15 m", "array 03", "array 04", "array 11", "array 30")


def _higher_resolution_cells(cells: list[ShadowCell]) -> list[ShadowCell]:
    """Return the test cases in `UNRESOLVED` with half the pixel size."""
    return [replace(c, name=f"{c.name}, sharp", pixels=2) for c in cells if c.name in UNRESOLVED]


CELLS = (
    HOME,
    *_one_factor_cells(),
    *_orthogonal_array_cells(),
    *_higher_resolution_cells([*_one_factor_cells(), *_orthogonal_array_cells()]),
)
