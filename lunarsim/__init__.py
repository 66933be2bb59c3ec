"""Closed-loop lunar descent: terrain, sensing, hazard maps, retargeting, guidance, touchdown."""

__version__ = "0.1.0"

from lunarsim.forks import watch_forks
from lunarsim.user_cache import ensure_caches

ensure_caches()
watch_forks()
