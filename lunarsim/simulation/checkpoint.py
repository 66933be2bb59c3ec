"""Checkpoints: copies of a running simulation that can be resumed more than once.

The copy shares nothing that changes in flight. The true world and its truth are constant and are
not copied. Arrays that share memory still do so in the copy; a plain pickle would separate them.
Objects that cannot be copied reliably (external code, local functions, graphics handles) are
refused.
"""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.simulation.loop import Simulation

# Packages whose objects hold all of their state.
_TRUSTED_PACKAGES = {"lunarsim", "numpy", "scipy", "filterpy"}
# Modules of the standard library whose objects refer to resources outside the process.
_EXTERNAL_MODULES = {
    "ctypes",
    "mmap",
    "multiprocessing",
    "socket",
    "subprocess",
    "threading",
    "weakref",
}


class CheckpointError(Exception):
    """Error: a simulation contains an object that cannot be copied reliably."""


class Checkpoint:
    """Copy of a running simulation at one moment, which can be resumed repeatedly.

    Parameters
    ----------
    simulation
        Simulation at the end of a cycle, or where a decision is due.

    Raises
    ------
    CheckpointError
        If the simulation contains an object that cannot be copied reliably.
    """

    def __init__(self, simulation: Simulation) -> None:
        world = simulation.world
        self._shared = (world, world.terrain, simulation.truth, simulation.scenario)
        file = io.BytesIO()
        try:
            _Writer(file, self._shared).dump(simulation)
        except (pickle.PicklingError, TypeError, AttributeError, RecursionError) as error:
            raise CheckpointError(str(error)) from error
        self._data = file.getbuffer()

    def resumed(self) -> Simulation:
        """Return a new simulation that continues from the checkpoint."""
        found = _Reader(io.BytesIO(self._data), self._shared).load()
        assert isinstance(found, Simulation)
        return found


class _Writer(pickle.Pickler):
    """Pickler of a simulation that writes shared objects as their index in `shared`.

    Arrays that share memory still do so after reading.
    """

    def __init__(self, file: io.BytesIO, shared: Sequence[Any]) -> None:
        super().__init__(file, protocol=5)
        self._shared_index = {id(obj): index for index, obj in enumerate(shared)}
        # First array seen for each owner of memory that is not itself an array.
        self._owners: dict[int, NDArray[Any]] = {}

    def persistent_id(self, obj: Any) -> int | None:
        """Return the index of an object that all copies share, or None if it is copied.

        Raise `PicklingError` for a class whose objects cannot be copied reliably.
        """
        if isinstance(obj, type):
            package = obj.__module__.partition(".")[0]
            if package not in _TRUSTED_PACKAGES and (
                package in _EXTERNAL_MODULES or package not in sys.stdlib_module_names
            ):
                raise pickle.PicklingError(f"{obj.__module__}.{obj.__qualname__}")
        return self._shared_index.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        """Pickle an array view so that it still shares memory with its base.

        Other objects are pickled as usual. Raise `PicklingError` for a view that cannot be rebuilt.
        """
        if type(obj) is not np.ndarray or obj.base is None:
            return NotImplemented
        root = obj
        while type(root.base) is np.ndarray:
            root = root.base
        if root.base is not None:
            # Memory of a kernel: several views would become several arrays.
            if self._owners.setdefault(id(root.base), root) is not root:
                raise pickle.PicklingError("two arrays share memory that no array owns")
            if root is obj:
                return NotImplemented
        flat = root if root.flags.c_contiguous else root.T
        if not flat.flags.c_contiguous or root.dtype.hasobject:
            raise pickle.PicklingError("view of an array that is not contiguous")
        offset = obj.__array_interface__["data"][0] - root.__array_interface__["data"][0]
        known = (obj.shape, obj.dtype, offset, obj.strides, obj.flags.writeable)
        return _rebuild_view, (root, *known)


def _rebuild_view(
    root: NDArray[Any], shape: tuple[int, ...], dtype: Any, offset: int, strides: tuple[int, ...],
    writeable: bool,
) -> NDArray[Any]:  # fmt: skip
    """Return an array that is a view of the memory of the array `root`.

    `shape` and `dtype` are those of the view; `offset` and `strides` are in bytes.
    """
    flat = root if root.flags.c_contiguous else root.T
    made: NDArray[Any] = np.ndarray(shape, dtype, flat, offset, strides)
    if made.flags.writeable and not writeable:
        made.flags.writeable = False
    return made


class _Reader(pickle.Unpickler):
    """Unpickler that restores shared objects by their index in `shared`."""

    def __init__(self, file: io.BytesIO, shared: Sequence[Any]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, index: int) -> Any:
        """Return the object with an index in the list of objects that all copies share."""
        return self._shared[index]
