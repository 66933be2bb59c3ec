"""Parts: scenario components selected by name, and the registry of these names.

A part is a frozen dataclass in SI units and radians. Its fields (name, default, unit, bounds,
meaning) define its table in a scenario file: the keys, the checks and the reference are generated
from them.
"""

from lunarsim.parts.module_permission import allow_modules
from lunarsim.parts.quantity import hidden, quantity
from lunarsim.parts.registry import CONTRACTS, kinds, loadable_parts, resolve
from lunarsim.parts.settings import PartSettings, settings_of

__all__ = [
    "CONTRACTS", "PartSettings", "allow_modules", "hidden", "kinds", "loadable_parts", "quantity",
    "resolve", "settings_of",
]  # fmt: skip
