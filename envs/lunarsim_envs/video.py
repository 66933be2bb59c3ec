"""Frames of an environment as a film."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lunarsim.errors import InputError
from lunarsim.whole_files import write_whole


def save_video(frames: Sequence[NDArray[np.uint8]], path: str | Path, fps: float = 2.0) -> None:
    """Write frames as a film, whole or not at all.

    Parameters
    ----------
    frames
        Images (rows, cols, 3), red, green and blue, all of one size.
    path
        ``.gif``, or ``.mp4``.
    fps
        Frames a second: an environment's ``metadata["render_fps"]`` shows a flight at its pace.

    Raises
    ------
    InputError
        If there is no frame, one has another size, or the name ends in something else.
    """
    path = Path(path)
    shapes = {frame.shape for frame in frames}
    if len(shapes) != 1:
        raise InputError("frames", sorted(shapes), "at least one image, all of one size")
    if not 0.1 <= fps <= 100.0:
        raise InputError("fps", fps, "from 0.1 to 100 frames a second")
    writers = {".gif": _gif, ".mp4": _mp4}
    if path.suffix.lower() not in writers:
        raise InputError("path", str(path), "a file name that ends in .gif or .mp4")
    write = writers[path.suffix.lower()]
    write_whole(path, lambda part: write(frames, part, fps))


def _gif(frames: Sequence[NDArray[np.uint8]], path: Path, fps: float) -> None:
    first, *others = (Image.fromarray(frame).quantize(128) for frame in frames)
    first.save(
        path, format="GIF", save_all=True, append_images=others, duration=round(1e3 / fps), loop=0
    )


def _mp4(frames: Sequence[NDArray[np.uint8]], path: Path, fps: float) -> None:
    rows, cols, _ = frames[0].shape
    named = path.with_name(f"{path.name}.mp4")  # the coder goes by the name
    try:
        film = cv2.VideoWriter(str(named), cv2.VideoWriter.fourcc(*"mp4v"), fps, (cols, rows))
        if not film.isOpened():
            raise InputError("path", str(path), "a .gif: this OpenCV writes no MP4")
        for frame in frames:
            film.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        film.release()
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)
