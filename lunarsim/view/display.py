"""Find out whether this machine has a display."""

from __future__ import annotations

import os
import sys

# Environment variables that indicate a display on Linux.
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def has_display() -> bool:
    """Return whether this machine has a display."""
    return sys.platform in ("win32", "darwin") or any(map(os.environ.get, _SCREENS))
