"""Delaunay triangulation of points in the plane, with exact predicates."""

from lunarsim.triangulation.delaunay import delaunay, delaunay_of_image

__all__ = ["delaunay", "delaunay_of_image"]
