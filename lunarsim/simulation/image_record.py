"""Camera images of a flight record: PNG files, and a table with time and pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.pose import Pose
from lunarsim.simulation.columns import IMAGES, MAX_IMAGES, MAX_READINGS_BYTES, ImageSource
from lunarsim.simulation.flight_files import arrow_table, read_columns, read_image, save_table
from lunarsim.typing import Array


@dataclass(frozen=True)
class ImageRecord:
    """Images of one camera in a flight record.

    Attributes
    ----------
    columns
        Time, true pose, exposure time and geometry of the camera: columns (n,) by name, as in
        ``images.NAME.parquet``.
    encoded
        Images as PNG data, n byte strings.
    """

    columns: Mapping[str, Array]
    encoded: Sequence[bytes]

    def __len__(self) -> int:
        return len(self.encoded)

    def __getitem__(self, index: int) -> NDArray[np.unsignedinteger[Any]]:
        """Return the detector counts (height, width) of one image, uint8 or uint16.

        Raises
        ------
        InputError
            If the image is damaged.
        """
        data = np.frombuffer(self.encoded[index], np.uint8)
        counts: NDArray[np.unsignedinteger[Any]] | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        if counts is None or counts.ndim != 2:
            raise InputError(
                "flight", index, "has a damaged image with this index",
                "Restore the file from a copy, or repeat the flight.",
            )  # fmt: skip
        return counts


class ImageRecorder:
    """Recorder of the images of one camera, up to a maximum size and number.

    Parameters
    ----------
    sensor
        Name of the camera.
    """

    def __init__(self, sensor: str) -> None:
        self._field = f"sensors.{sensor}"
        self._rows: list[Array] = []
        self._encoded: list[bytes] = []
        self._bytes = 0
        self._is_full = False

    def __len__(self) -> int:
        return len(self._encoded)

    def add(self, image: CameraImage, lander: Pose) -> bool:
        """Record an image, with the true pose of the lander at its time.

        Return false for the first image that exceeds the maximum size or number of images. This one
        and later ones are not recorded.

        Raises
        ------
        InputError
            If the counts are not an array (height, width) of type uint8 or uint16.
        """
        if self._is_full:
            return True
        counts = np.asarray(image.counts)
        wanted = (image.camera.height, image.camera.width)
        if counts.shape != wanted or counts.dtype not in (np.uint8, np.uint16):
            raise InputError(
                self._field, f"{counts.dtype} {counts.shape}",
                f"must give counts of type uint8 or uint16 and shape {wanted}, because its images "
                "are recorded",
            )  # fmt: skip
        self._bytes += counts.nbytes
        if self._bytes > MAX_READINGS_BYTES or len(self) == MAX_IMAGES:
            self._is_full = True
            return False
        self._rows.append(IMAGES.row(ImageSource(image, image.camera.view(lander))))
        self._encoded.append(cv2.imencode(".png", counts)[1].tobytes())
        return True

    def record(self, first: int = 0) -> ImageRecord:
        """Return the images recorded up to now, from the one with index `first` on."""
        return ImageRecord(IMAGES.as_columns(self._rows[first:]), tuple(self._encoded[first:]))


def save_images(folder: Path, sensor: str, images: ImageRecord) -> list[Path]:
    """Write the images of a camera into the folder of a flight; return the files.

    They are ``images/NAME/000000.png`` and so on, and ``images.NAME.parquet``.
    """
    files = [folder / name for name in _file_names(sensor, len(images))]
    if files:
        files[0].parent.mkdir(parents=True, exist_ok=True)
    for path, data in zip(files, images.encoded, strict=True):
        atomic_write(path, lambda part, data=data: part.write_bytes(data))  # type: ignore[misc]
    names = pa.array(_file_names(sensor, len(images)), pa.string())
    table = _table_path(folder, sensor)
    save_table(arrow_table(IMAGES, images.columns).append_column("file", names), table)
    return [*files, table]


def load_images(folder: Path, sensor: str) -> ImageRecord:
    """Read the images of a camera from the folder of a flight, without decoding them.

    Raises
    ------
    InputError
        If a file is missing or damaged, or an image has not the size in the table.
    """
    columns = read_columns(folder, _table_path(folder, sensor), list(IMAGES.columns()))
    encoded, total = [], 0
    sizes = zip(columns["width"], columns["height"], strict=True)
    for name, size in zip(_file_names(sensor, len(columns["time"])), sizes, strict=True):
        # Noise can make a PNG file larger than its pixels.
        encoded.append(read_image(folder, folder / name, size, 2 * MAX_READINGS_BYTES - total))
        total += len(encoded[-1])
    return ImageRecord(columns, tuple(encoded))


def remove_images(folder: Path) -> None:
    """Remove the images of an earlier flight from its folder; other files stay."""
    for table in folder.glob("images.*.parquet"):
        sensor = table.name.removeprefix("images.").removesuffix(".parquet")
        for path in (folder / "images" / sensor).glob(6 * "[0-9]" + ".png"):
            path.unlink()
        table.unlink()


def _table_path(folder: Path, sensor: str) -> Path:
    """Return the path of the table of a camera's images."""
    return folder / f"images.{sensor}.parquet"


def _file_names(sensor: str, count: int) -> list[str]:
    """Return the names of the files of a camera's images, relative to the folder."""
    return [f"images/{sensor}/{index:06d}.png" for index in range(count)]
