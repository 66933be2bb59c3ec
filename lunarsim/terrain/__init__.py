"""The ground: measured or procedural relief with rocks on it, and every question asked of it."""

from lunarsim.terrain.craters import CraterLaw, add_craters, crater_profile
from lunarsim.terrain.dtm import DtmInfo, load_dtm, read_info
from lunarsim.terrain.hazard_field import hazard_field
from lunarsim.terrain.heightfield import Heightfield
from lunarsim.terrain.relief import add_detail, fractal_relief
from lunarsim.terrain.rocks import (
    RockField,
    RockModel,
    golombek_cover,
    golombek_number,
    place_rocks,
    sample_diameters,
)
from lunarsim.terrain.terrain import RayHits, Terrain

__all__ = [
    "CraterLaw",
    "DtmInfo",
    "Heightfield",
    "RayHits",
    "RockField",
    "RockModel",
    "Terrain",
    "add_craters",
    "add_detail",
    "crater_profile",
    "fractal_relief",
    "golombek_cover",
    "golombek_number",
    "hazard_field",
    "load_dtm",
    "place_rocks",
    "read_info",
    "sample_diameters",
]
