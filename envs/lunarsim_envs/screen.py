"""A window that shows frames at their pace."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError

# Any of them tells of a screen, beside those of Windows and macOS.
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")


def _pygame() -> Any:
    try:
        import pygame  # noqa: PLC0415 - an extra
    except ImportError:
        raise gymnasium.error.DependencyNotInstalled(
            "render_mode 'human' needs pygame: pip install \"lunarsim[screen]\""
        ) from None
    return pygame


def modes_here(modes: Sequence[str]) -> list[str]:
    """Return modes of rendering without "human" where there is no pygame, or no screen."""
    screen = sys.platform in ("win32", "darwin") or any(map(os.environ.get, _SCREENS))
    there = screen and importlib.util.find_spec("pygame") is not None
    return [mode for mode in modes if there or mode != "human"]


class Screen:
    """Shows frames (rows, cols, 3), all of one size; the window opens with the first.

    Parameters
    ----------
    fps
        Frames a second.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        If pygame is not there.
    InputError
        If there is no screen.
    """

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._window: Any = None
        pygame = _pygame()
        try:
            pygame.display.init()
        except pygame.error as error:
            raise InputError(
                "render_mode", "human", f"'rgb_array': there is no screen here ({error})"
            ) from None
        self._clock = pygame.time.Clock()

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show a frame, once the one before has been shown for its time."""
        pygame = _pygame()
        if not pygame.display.get_init():
            pygame.display.init()
        if self._window is None:
            self._window = pygame.display.set_mode((frame.shape[1], frame.shape[0]))
            pygame.display.set_caption("lunarsim")
        self._clock.tick(self._fps)
        self._window.blit(pygame.surfarray.make_surface(frame.transpose(1, 0, 2)), (0, 0))
        # Without it the system takes the window for one that hangs.
        pygame.event.pump()
        pygame.display.flip()

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window = None
            _pygame().display.quit()
