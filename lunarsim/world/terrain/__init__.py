"""True terrain: measured or procedural relief with rocks, and its queries."""

from lunarsim.world.terrain.albedo_map import AlbedoMap
from lunarsim.world.terrain.crater_ages import AgedCraters
from lunarsim.world.terrain.craters import CraterLaw, add_craters, crater_profile
from lunarsim.world.terrain.fillets import add_fillets
from lunarsim.world.terrain.fine_relief import add_fine_roughness
from lunarsim.world.terrain.hazard_field import hazard_field
from lunarsim.world.terrain.heightfield import Heightfield
from lunarsim.world.terrain.placement import CraterClusters, place_given_rocks, place_rocks
from lunarsim.world.terrain.relief import add_detail, fractal_relief
from lunarsim.world.terrain.terrain import RayHits, Terrain

__all__ = [
    "AgedCraters",
    "AlbedoMap",
    "CraterClusters",
    "CraterLaw",
    "Heightfield",
    "RayHits",
    "Terrain",
    "add_craters",
    "add_detail",
    "add_fillets",
    "add_fine_roughness",
    "crater_profile",
    "fractal_relief",
    "hazard_field",
    "place_given_rocks",
    "place_rocks",
]
