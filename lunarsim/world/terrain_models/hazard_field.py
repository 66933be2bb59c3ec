"""An artificial hazard field on flat grassland."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rng import RandomStreams
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.terrain import Terrain, hazard_field
from lunarsim.world.terrain_models.interface import check_posts


@dataclass(frozen=True)
class HazardFieldTerrain:
    """Settings of a field of boulders and craters on flat grassland (quadtree paper).

    Boulders and craters are sampled at random for every flight.

    The rock settings of the scenario are not used.
    """

    size: float = quantity(160.0, "m", gt=0, help="side of the square of flat grassland")
    posting: float = quantity(0.25, "m", gt=0, help="grid spacing of the relief")
    field: float = quantity(
        100.0,
        "m",
        gt=0,
        help="side of the square field of boulders and craters; the grassland around it has none",
    )
    field_rotation: float = quantity(
        20.0,
        "deg",
        help="rotation of the square with boulders and craters, counter-clockwise from east",
    )
    boulders: int = quantity(
        300, ge=0, help="number of boulders, which have diameters of 0.4 to 1 m"
    )
    craters: int = quantity(24, ge=0, help="number of craters, which have diameters of 2 to 5 m")

    def __post_init__(self) -> None:
        check_posts(self.size, self.posting)
        if self.field > self.size:
            raise InputError(
                "field", self.field, f"must be at most size_m, which is {self.size:g} m"
            )

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return the hazard field of one flight, sampled from its random streams.

        The argument `rocks` is not used.
        """
        return hazard_field(
            streams.get("rocks"),
            size=self.field,
            surround=self.size,
            posting=self.posting,
            turn=self.field_rotation,
            boulders=self.boulders,
            craters=self.craters,
        )
