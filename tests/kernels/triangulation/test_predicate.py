"""The in-circle predicate against exact integers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lunarsim.triangulation import _geometry_kernels as kernels
from tests.reference.triangulation import in_circle


@given(*[st.integers(0, 2**24)] * 8)
def test_predicate_is_exact(ax, ay, bx, by, cx, cy, px, py):
    wanted = in_circle((ax, ay), (bx, by), (cx, cy), (px, py))
    assert kernels.in_circle(ax, ay, bx, by, cx, cy, px, py) == wanted


@given(st.integers(1, 2**12), st.integers(0, 2**11), st.integers(-1, 1))
def test_predicate_on_nearly_cocircular_points(r, shift, off):
    """Corners of a square and a point a unit off its circle: the float filter cannot tell."""
    s = 1000 * r + shift
    corners = (0, 0), (s, 0), (s, s)
    p = (0 + off, s)
    assert kernels.in_circle(*corners[0], *corners[1], *corners[2], *p) == in_circle(*corners, p)
