"""Write images as a video: MP4 or GIF."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lunarsim.errors import InputError

Frames = Iterable[NDArray[np.uint8]]
# Colours of a GIF frame.
_GIF_COLOURS = 128


def write_gif(frames: Frames, path: Path, fps: float) -> None:
    """Write RGB images (rows, cols, 3) as a GIF at `fps` frames per second."""
    first, *others = (Image.fromarray(frame).quantize(_GIF_COLOURS) for frame in frames)
    first.save(
        path, format="GIF", save_all=True, append_images=others, duration=round(1e3 / fps), loop=0
    )


def write_mp4(frames: Frames, path: Path, fps: float) -> None:
    """Write RGB images (rows, cols, 3) as MPEG-4 at `fps` frames per second.

    All images have one size. Each image is written before the next one is requested.

    Raises
    ------
    InputError
        If the installed OpenCV cannot write MP4.
    OSError
        If the file is incomplete, for instance because the disk is full.
    """
    named = path.with_name(f"{path.name}.mp4")  # OpenCV selects the container by the suffix
    film: Any = None
    count = 0
    try:
        for frame in frames:
            rows, cols, _ = frame.shape
            if film is None:
                film = cv2.VideoWriter(
                    str(named), cv2.VideoWriter.fourcc(*"mp4v"), fps, (cols, rows)
                )
                if not film.isOpened():
                    raise InputError(
                        "path", str(path),
                        "must end in .gif, because the installed OpenCV cannot write MP4",
                    )  # fmt: skip
            film.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
            count += 1
        film.release()
        # OpenCV does not report errors of the disk.
        if int(cv2.VideoCapture(str(named)).get(cv2.CAP_PROP_FRAME_COUNT)) != count:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)
