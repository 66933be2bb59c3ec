from lunarsim.campaign.comparison import CompareResult as CompareResult
from lunarsim.errors import InputError as InputError
from lunarsim.errors import RenderingError as RenderingError
from lunarsim.evaluation.map_quality import map_quality as map_quality
from lunarsim.facade import compare as compare
from lunarsim.facade import fly as fly
from lunarsim.facade import load_scenario as load_scenario
from lunarsim.facade import render as render
from lunarsim.grid import Grid as Grid
from lunarsim.onboard.hazards.gaussian_dem import gaussian_dem as gaussian_dem
from lunarsim.onboard.hazards.hazard_map import HazardMap as HazardMap
from lunarsim.parts.module_permission import allow_modules as allow_modules
from lunarsim.rng import RandomStreams as RandomStreams
from lunarsim.rng import flight_seed as flight_seed
from lunarsim.safety import exact_safety as exact_safety
from lunarsim.scenario.scenario import Scenario as Scenario
from lunarsim.simulation.flight import Flight as Flight
from lunarsim.simulation.loop import Simulation as Simulation
from lunarsim.simulation.worlds import build_world as build_world
from lunarsim.simulation.worlds import rebuild_world as rebuild_world
from lunarsim.viz.flight import FlightFigures as FlightFigures
from lunarsim.viz.flight import plot_flight as plot_flight
from lunarsim.world.site_safety import site_safety as site_safety
from lunarsim.world.terrain.dtm import load_terrain as load_terrain
from lunarsim.world.terrain.heightfield import Heightfield as Heightfield
from lunarsim.world.terrain.terrain import Terrain as Terrain

__version__: str
