"""Campaigns: many flights, their execution, results and statistics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lunarsim.campaign.comparison import CompareResult, compare

__all__ = ["CompareResult", "compare"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use; worker processes do not need them."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from lunarsim.campaign import comparison  # noqa: PLC0415

    return getattr(comparison, name)
