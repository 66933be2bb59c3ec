"""Recordings of flights for the Rerun viewer, and films."""

from __future__ import annotations

from lunarsim._lazy import lazy_names

# Module of each public name, imported at first use; `__init__.pyi` has them for type checkers.
_MODULES = {
    "save_film": "lunarsim.view.film",
    "save_recording": "lunarsim.view.viewer",
}
__all__ = sorted(_MODULES)  # noqa: PLE0605
__getattr__, __dir__ = lazy_names(__name__, _MODULES, globals())
