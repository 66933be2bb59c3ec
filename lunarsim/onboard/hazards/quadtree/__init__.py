"""Quadtree map of LiDAR points and selection of landing sites on it.

Marcus, Setterfield, Hewitt and Chen, "Landing Site Selection with a Variable-Resolution
SLAM-Refined Map".
"""

from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapper
from lunarsim.onboard.hazards.quadtree.settings import InterestMap, SiteSettings
from lunarsim.onboard.hazards.quadtree.sites import SITE_STATUS, Site, SiteSelection, SiteSelector
from lunarsim.onboard.hazards.quadtree.tree import InsertionCounts, QuadtreeMap

__all__ = [
    "SITE_STATUS",
    "InsertionCounts",
    "InterestMap",
    "QuadtreeMap",
    "QuadtreeMapper",
    "Site",
    "SiteSelection",
    "SiteSelector",
    "SiteSettings",
]
