"""Quadtree map and the selection of landing sites on it.

Marcus, Setterfield, Hewitt and Chen, "Landing Site Selection with a Variable-Resolution SLAM-Refined
Map".
"""

from lunarsim.hazards.quadtree.tree import Inserted, QuadtreeMap

__all__ = ["Inserted", "QuadtreeMap"]
