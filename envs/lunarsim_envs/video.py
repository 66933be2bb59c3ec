"""Write frames of an environment as a video.

Gymnasium's RecordVideo needs MoviePy, which requires an older Pillow than this package.
`RecordVideos` writes the same videos with OpenCV and needs no other package.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError
from lunarsim.view.video import write_gif, write_mp4


class RecordVideos(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Record episodes of an environment as videos, ``PREFIX-episode-N.mp4``.

    A video contains the frames from the reset on: one per step, or all frames of the render mode
    ``"rgb_array_list"``. The video of an unfinished episode is written at the next reset or at
    `close`.

    Parameters
    ----------
    env
        Environment with render mode ``"rgb_array"`` or ``"rgb_array_list"``.
    folder
        Folder for the videos; it is created if needed.
    wanted
        Function of the episode number, from 0, that selects episodes; default: all.
    prefix
        Prefix of the file names.
    fps
        Frame rate, frames per second. Default: ``metadata["render_fps"]`` of the environment, which
        is real time.

    Raises
    ------
    InputError
        If the environment renders no frames.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        folder: str | Path,
        wanted: Callable[[int], bool] | None = None,
        prefix: str = "film",
        fps: float | None = None,
    ) -> None:
        super().__init__(env)
        if env.render_mode not in ("rgb_array", "rgb_array_list"):
            raise InputError(
                "render_mode", env.render_mode, "must be 'rgb_array' or 'rgb_array_list'"
            )
        self.folder, self.prefix = Path(folder), prefix
        self._wanted = wanted if wanted is not None else lambda _: True
        self._fps = fps if fps is not None else float(env.metadata["render_fps"])
        self._frames: list[NDArray[np.uint8]] = []
        self._flight, self._filming = -1, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Write the video of the last episode and start a new episode."""
        self._write()
        shown = super().reset(seed=seed, options=options)
        self._flight += 1
        self._filming = self._wanted(self._flight)
        self._take()
        return shown

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and write the video if the episode has ended."""
        result = super().step(action)
        self._take()
        if result[2] or result[3]:
            self._write()
        return result

    def _take(self) -> None:
        if self._filming:
            frames: Any = self.env.render()
            self._frames += frames if isinstance(frames, list) else [frames]

    def _write(self) -> None:
        frames, self._frames, self._filming = self._frames, [], False
        if frames:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self.folder / f"{self.prefix}-episode-{self._flight}.mp4"
            save_video(frames, path, self._fps)

    def close(self) -> None:
        """Write the video of the last episode and close the environment."""
        self._write()
        super().close()


def save_video(frames: Sequence[NDArray[np.uint8]], path: str | Path, fps: float = 2.0) -> None:
    """Write images as a GIF or MP4 video; an error leaves no partial file.

    Parameters
    ----------
    frames
        RGB images (rows, cols, 3), all of one size.
    path
        File to write, ``.gif`` or ``.mp4``.
    fps
        Frame rate, frames per second; ``metadata["render_fps"]`` of an environment is real time.

    Raises
    ------
    InputError
        If there are no frames, sizes differ, or the suffix or the frame rate is invalid.
    """
    path = Path(path)
    shapes = {frame.shape for frame in frames}
    if len(shapes) != 1:
        raise InputError("frames", sorted(shapes), "must be one or more images of the same size")
    if not 0.1 <= fps <= 100.0:
        raise InputError("fps", fps, "must be between 0.1 and 100 (images per second)")
    writers = {".gif": write_gif, ".mp4": write_mp4}
    if path.suffix.lower() not in writers:
        raise InputError("path", str(path), "must be a file name that ends in .gif or .mp4")
    write = writers[path.suffix.lower()]
    atomic_write(path, lambda part: write(frames, part, fps))
