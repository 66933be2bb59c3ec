"""Keep large arrays in the rows of a study as short text."""

from __future__ import annotations

import base64
import io
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack_array(array: NDArray[Any]) -> str:
    """Return an array of numbers or booleans as compressed text, for a row of a study."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return base64.b64encode(zlib.compress(file.getvalue())).decode("ascii")


def unpack_array(text: str) -> NDArray[Any]:
    """Return the array in a text of `pack_array`, with equal values and type."""
    data = zlib.decompress(base64.b64decode(text))
    return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))
