"""Number, size and shape of the true and of the expected rocks of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.field import RockModel


@dataclass(frozen=True)
class RockPopulation(RockModel):
    """Rocks of the Golombek distribution, drawn for every flight.

    Attributes
    ----------
    clustered, block_crater
        Fraction of the rocks that lie as blocks around craters, and the minimum diameter of craters
        with blocks, m. Blocks come from below the regolith, 4 to 5 m thick on maria (Lunar
        Sourcebook 1991, ch. 7), which craters reach from a diameter of about 25 m. Metre-sized
        blocks outlast such craters (median 40 to 80 Myr: Basilevsky et al. 2013), so that craters
        of all ages have them.
    fillet
        Height of the soil banked against rocks over their exposed height. Fillets are part of the
        relief and need a posting that is a fraction of a rock's size.
    cube_area
        Area of a cube of side D in the distribution's cover. "square": D^2, as Golombek counts the
        covered area; "disc": the disc of diameter D, so that cubes cover 4 / pi times the nominal
        cover, as in the reproduced experiment of the shadow EKF paper.
    """

    cover: float = quantity(
        0.05, ge=0, le=0.2, help="fraction k of the terrain covered by rocks of all sizes"
    )
    min_diameter: float = quantity(0.15, "m", ge=0.01, help="minimum diameter of generated rocks")
    max_diameter: float = quantity(3.0, "m", gt=0, help="maximum diameter of generated rocks")
    clustered: float = quantity(
        0.0, ge=0, le=1, help="fraction of the rocks that lies around craters"
    )
    block_crater: float = quantity(
        25.0, "m", gt=0, help="minimum diameter of craters with rocks around them"
    )
    fillet: float = quantity(
        0.0, ge=0, le=0.5, help="height of soil banked against rocks over their exposed height"
    )
    cube_area: Literal["square", "disc"] = quantity(
        "square", help="area of a cube in the cover: its own, or the disc of its side as diameter"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_diameter >= self.max_diameter:
            raise InputError(
                "min_diameter",
                self.min_diameter,
                f"must be less than max_diameter_m ({self.max_diameter})",
            )

    @property
    def share(self) -> float:
        """Area of a disc over the area that a rock of its diameter has in the cover."""
        squares = self.shape == "cube" and self.cube_area == "square"
        return 0.25 * np.pi if squares else 1.0

    def model(self) -> RockModel:
        """Return the shapes and burial of the rocks."""
        return RockModel(self.shape, self.height_ratio, self.burial, self.axis_ratio)


@dataclass(frozen=True)
class RockExpectation(RockModel):
    """Rocks of the Golombek distribution that the mission expects."""

    cover: float = quantity(
        0.05, gt=0, le=0.2, help="fraction k of the terrain covered by rocks of all sizes"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.cover <= 0.2:
            raise InputError("rocks.cover", self.cover, "must be more than 0 and at most 0.2")

    @classmethod
    def given(cls, rocks: RockExpectation | None) -> RockExpectation:
        """Return the given expectation, or the default for None.

        Raises
        ------
        InputError
            If it has another type.
        """
        if rocks is None:
            return cls()
        if not isinstance(rocks, cls):
            raise InputError("rocks", rocks, "must be a RockExpectation, or None for its defaults")
        return rocks

    def model(self) -> RockModel:
        """Return the expected shapes and burial of the rocks."""
        burial = (0.0, 0.0) if self.shape == "hemisphere" else self.burial
        return RockModel(self.shape, self.height_ratio, burial, self.axis_ratio)
