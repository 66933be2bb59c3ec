"""Campaigns: many flights, their execution, results and statistics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lunarsim.campaign.comparison import CompareResult, compare

__all__ = ["CompareResult", "compare"]


def __getattr__(name: str) -> Any:
    """Return a public name; loaded late, since workers need no more than their own module."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from lunarsim.campaign import comparison  # noqa: PLC0415

    return getattr(comparison, name)
