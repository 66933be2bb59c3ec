"""Parts: dataclasses that declare their settings once, and the registry that finds them by name.

A part is a frozen dataclass in SI units and radians. What stands in its fields (name, default,
unit, bounds, meaning) is all there is to its table in a scenario file: keys, checks and reference
are made from it.
"""

from lunarsim.parts.allowed import allow_modules
from lunarsim.parts.quantity import hidden, quantity
from lunarsim.parts.registry import CONTRACTS, kinds, loadable, resolve
from lunarsim.parts.settings import PartSettings, settings_of

__all__ = [
    "CONTRACTS", "PartSettings", "allow_modules", "hidden", "kinds", "loadable", "quantity",
    "resolve", "settings_of",
]  # fmt: skip
