"""Number, size and shape of the true and of the expected rocks of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.rock_file import GivenRocks, load_rocks


@dataclass(frozen=True)
class RockPopulation(RockModel):
    """Settings of the true rocks: Golombek size distribution, shapes and placement.

    The rocks are sampled at random for every flight.

    Attributes
    ----------
    cluster_fraction, min_block_crater_diameter
        Fraction of the rocks that lie as blocks around craters, and the minimum diameter of craters
        with blocks, m. Blocks come from below the regolith, 4 to 5 m thick on maria (Lunar
        Sourcebook 1991, ch. 7); craters wider than about 25 m excavate from this depth. Metre-sized
        blocks outlast such craters (median 40 to 80 Myr: Basilevsky et al. 2013), so that craters
        of all ages have them.
    fillet_height_ratio
        Height of the soil banked against rocks over their exposed height. Fillets are part of the
        relief and need a grid spacing that is a fraction of a rock's size.
    path
        CSV file with rocks at given places, in the frame of the terrain, which replace random
        rocks. Shapes and burial are random.
    cube_area
        Area that a cube of side D contributes to the cover. "square": D^2, as Golombek counts the
        covered area; "disc": pi D^2 / 4, so that cubes cover 4 / pi times the nominal cover, as in
        the experiment of the shadow EKF paper.
    """

    cover: float = quantity(
        0.05,
        ge=0,
        le=0.2,
        help="fraction of the terrain area that true rocks of all sizes cover (Golombek's k); 0: "
        "no rocks; expected_rocks.cover must be set separately",
    )
    min_diameter: float = quantity(0.15, "m", ge=0.01, help="minimum diameter of generated rocks")
    max_diameter: float = quantity(3.0, "m", gt=0, help="maximum diameter of generated rocks")
    cluster_fraction: float = quantity(
        0.0,
        ge=0,
        le=1,
        help="fraction of the rocks that lie around craters; the other rocks lie at random places",
    )
    min_block_crater_diameter: float = quantity(
        25.0, "m", gt=0, help="minimum diameter of craters that have rocks around them"
    )
    fillet_height_ratio: float = quantity(
        0.0,
        ge=0,
        le=0.5,
        help="height of the soil banked against a rock, divided by the rock's exposed height; 0: "
        "none",
    )
    path: Path | None = quantity(
        None,
        help="CSV file with rocks at given places, relative to the scenario file; its header has "
        "the columns x (m), y (m), diameter (m) and, if known, height (m); omitted: random rocks, "
        "otherwise the keys of number, sizes and clusters of random rocks are not used",
    )
    cube_area: Literal["square", "disc"] = quantity(
        "square",
        help="area that a cube of side D contributes to the rock cover: square (D^2) or disc (pi "
        "D^2 / 4)",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.given_rocks()
        if self.min_diameter >= self.max_diameter:
            raise InputError(
                "min_diameter",
                self.min_diameter,
                f"must be less than max_diameter_m, which is {self.max_diameter:g} m",
            )

    def given_rocks(self) -> GivenRocks | None:
        """Read the rocks at given places; None if `path` is omitted.

        Raises
        ------
        InputError
            If the file is missing or invalid.
        """
        return None if self.path is None else load_rocks(self.path)

    @property
    def disc_area_ratio(self) -> float:
        """Area of a disc of diameter D over the area that a rock of size D covers."""
        squares = self.shape == "cube" and self.cube_area == "square"
        return 0.25 * np.pi if squares else 1.0

    def model(self) -> RockModel:
        """Return the statistics of the rocks' shapes and burial."""
        return RockModel(self.shape, self.height_ratio, self.burial, self.axis_ratio)


@dataclass(frozen=True)
class RockExpectation(RockModel):
    """Settings of the rocks that the mission expects: Golombek distribution, shapes."""

    cover: float = quantity(
        0.05,
        gt=0,
        le=0.2,
        help="fraction of the terrain area that the mission expects rocks to cover (Golombek's k); "
        "the true fraction, rocks.cover, must be set separately",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.cover <= 0.2:
            raise InputError("rocks.cover", self.cover, "must be above 0 and at most 0.2")

    @classmethod
    def or_default(cls, rocks: RockExpectation | None) -> RockExpectation:
        """Return the expected rocks `rocks`, or the default expectation for None.

        Raises
        ------
        InputError
            If `rocks` has another type.
        """
        if rocks is None:
            return cls()
        if not isinstance(rocks, cls):
            raise InputError("rocks", rocks, "must be a RockExpectation or None")
        return rocks

    def model(self) -> RockModel:
        """Return the expected statistics of the rocks' shapes and burial.

        Hemispheres have no burial.
        """
        burial = (0.0, 0.0) if self.shape == "hemisphere" else self.burial
        return RockModel(self.shape, self.height_ratio, burial, self.axis_ratio)
