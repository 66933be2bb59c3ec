"""Show frames in a window at a fixed rate."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.view.display import has_display

# Resolution of the figure, pixels per inch; any value works.
_DPI = 100


def _can_open_windows() -> bool:
    """Return whether Matplotlib can open windows on this machine."""
    # Imported here because Matplotlib searches for a GUI toolkit, which takes half a second.
    import matplotlib.pyplot as plt  # noqa: PLC0415
    from matplotlib.backends import BackendFilter, backend_registry  # noqa: PLC0415

    return plt.get_backend().lower() in backend_registry.list_builtin(BackendFilter.INTERACTIVE)


def available_render_modes(modes: Sequence[str]) -> list[str]:
    """Return `modes` without "human" if this machine cannot open a window."""
    return [mode for mode in modes if mode != "human" or (has_display() and _can_open_windows())]


class FrameWindow:
    """Window that shows images of an environment at a fixed rate.

    All images (rows, cols, 3) have the same size; the first one opens the window.

    Parameters
    ----------
    fps
        Frame rate, frames per second.

    Raises
    ------
    InputError
        If no window can be opened.
    """

    def __init__(self, fps: float) -> None:
        if not _can_open_windows():
            raise InputError(
                "render_mode", "human",
                "needs a display and a GUI toolkit for Matplotlib (on Debian: apt install "
                "python3-tk)",
                "Without these, use 'rgb_array'.", show_value=False,
            )  # fmt: skip
        self._seconds = 1.0 / fps
        self._figure: Any = None
        self._image: Any = None
        self._due = 0.0

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show a frame (rows, cols, 3) when the previous one has been shown for 1 / fps."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        if self._figure is None:
            rows, cols = frame.shape[:2]
            self._figure = plt.figure("lunarsim", figsize=(cols / _DPI, rows / _DPI), dpi=_DPI)
            self._image = self._figure.figimage(frame)
            self._figure.show()
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = time.monotonic() + self._seconds
        self._image.set_data(frame)
        self._figure.canvas.draw()
        # Otherwise the system reports the window as not responding.
        self._figure.canvas.flush_events()

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None:
            import matplotlib.pyplot as plt  # noqa: PLC0415

            plt.close(self._figure)
            self._figure = None
