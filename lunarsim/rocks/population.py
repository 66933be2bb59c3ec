"""Rocks of a scenario: how many, how large and of what shape; as drawn, and as expected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.field import RockModel


@dataclass(frozen=True)
class RockPopulation(RockModel):
    """Rocks by the Golombek law, drawn anew for every flight.

    Attributes
    ----------
    cover
        Fraction k of the ground under rocks of all sizes.
    min_diameter, max_diameter
        Of the rocks drawn, m.
    clustered, block_crater
        Share of the rocks that lie as blocks about craters, and the diameter from which craters
        have blocks, m: they come from below the regolith, 4 to 5 m thick on maria (Lunar
        Sourcebook 1991, ch. 7), which craters reach from about 25 m on. Metre-sized blocks outlast
        such craters (median 40 to 80 Myr: Basilevsky et al. 2013), so all ages have them.
    fillet
        Height of the soil banked against rocks over theirs above the ground: a part of the relief,
        so it shows where its posts are a fraction of a rock apart.
    cube_area
        Area by which a cube of side D counts in the law's cover: its own, D^2, as Golombek counts
        the ground that rocks cover; or that of the disc of its side, so that cubes cover 4 / pi of
        what the law says, as the shadow EKF paper's experiment is flown here.

    The rest as in `RockModel`.
    """

    cover: float = quantity(0.05, ge=0, le=0.2, help="fraction k of ground under rocks")
    min_diameter: float = quantity(0.15, "m", ge=0.01, help="of the rocks drawn")
    max_diameter: float = quantity(3.0, "m", gt=0, help="of the rocks drawn")
    clustered: float = quantity(0.0, ge=0, le=1, help="share of them that lies about craters")
    block_crater: float = quantity(25.0, "m", gt=0, help="least diameter of craters with blocks")
    fillet: float = quantity(0.0, ge=0, le=0.5, help="height of soil banked against them, a share")
    cube_area: Literal["square", "disc"] = quantity(
        "square", help="area by which cubes count: their own, or that of the disc of their side"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_diameter >= self.max_diameter:
            raise InputError(
                "min_diameter", self.min_diameter, f"less than max_diameter_m, {self.max_diameter}"
            )

    @property
    def share(self) -> float:
        """Rocks over discs of their diameters that cover as much."""
        squares = self.shape == "cube" and self.cube_area == "square"
        return 0.25 * np.pi if squares else 1.0

    def model(self) -> RockModel:
        """Return how the rocks are shaped and how deep they sit."""
        return RockModel(self.shape, self.height_ratio, self.burial, self.axis_ratio)


@dataclass(frozen=True)
class RockExpectation(RockModel):
    """Rocks that the mission expects, by the Golombek law.

    Attributes
    ----------
    cover
        Fraction k of the ground under rocks of all sizes.

    The rest as in `RockModel`.
    """

    cover: float = quantity(0.05, gt=0, le=0.2, help="fraction k of ground under rocks")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.cover <= 0.2:
            raise InputError("rocks.cover", self.cover, "more than 0 and at most 0.2")

    @classmethod
    def given(cls, rocks: RockExpectation | None) -> RockExpectation:
        """Return what is expected, the defaults for None.

        Raises
        ------
        InputError
            If it is something else.
        """
        if rocks is None:
            return cls()
        if not isinstance(rocks, cls):
            raise InputError("rocks", rocks, "a RockExpectation, or None for its defaults")
        return rocks

    def model(self) -> RockModel:
        """Return how the rocks are thought to be shaped and how deep they sit."""
        burial = (0.0, 0.0) if self.shape == "hemisphere" else self.burial
        return RockModel(self.shape, self.height_ratio, burial, self.axis_ratio)
