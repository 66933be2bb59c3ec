"""A simulation as it stands, kept so that it can be gone on with more than once.

The copy shares nothing that flying changes. What is true of the ground is not copied: worlds and
truths do not change. Arrays that look at the same memory still do so in the copy: a pickle by
itself would make two of them. What cannot be copied with certainty (code that is not this
package's, functions made on the way, handles of the graphics card) is refused, not guessed.
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

# Whose objects are known to hold all of their state in themselves.
_KNOWN = {"lunarsim", "numpy", "scipy", "filterpy"}
# Of the standard library, what stands for things outside of the process.
_OUTSIDE = {"ctypes", "mmap", "multiprocessing", "socket", "subprocess", "threading", "weakref"}


class NoCheckpointError(Exception):
    """A simulation holds something of which no copy is certain."""


class Checkpoint:
    """A simulation at one moment.

    Parameters
    ----------
    simulation
        At the end of a cycle, or where a decision is due.

    Raises
    ------
    NoCheckpointError
        If it holds something of which no copy is certain.
    """

    def __init__(self, simulation: Simulation) -> None:
        world = simulation.world
        self._shared = (world, world.terrain, simulation.truth, simulation.truth.safety,
                        simulation.scenario)  # fmt: skip
        file = io.BytesIO()
        try:
            _Writer(file, self._shared).dump(simulation)
        except (pickle.PicklingError, TypeError, AttributeError, RecursionError) as error:
            raise NoCheckpointError(str(error)) from error
        self._data = file.getbuffer()

    def resumed(self) -> Simulation:
        """Return a simulation that stands where the one that was kept stood."""
        found = _Reader(io.BytesIO(self._data), self._shared).load()
        assert isinstance(found, Simulation)
        return found


class _Writer(pickle.Pickler):
    def __init__(self, file: io.BytesIO, shared: Sequence[Any]) -> None:
        super().__init__(file, protocol=5)
        self._places = {id(one): place for place, one in enumerate(shared)}
        # Owners of memory that is not an array's, and the array that stands for each.
        self._owners: dict[int, NDArray[Any]] = {}

    def persistent_id(self, one: Any) -> int | None:
        """Return the place of what is shared; refuse what nobody here knows."""
        if isinstance(one, type):
            room = one.__module__.partition(".")[0]
            if room not in _KNOWN and (room in _OUTSIDE or room not in sys.stdlib_module_names):
                raise pickle.PicklingError(f"{one.__module__}.{one.__qualname__}")
        return self._places.get(id(one))

    def reducer_override(self, one: Any) -> Any:
        """Return how an array that looks at another's memory is made again: as such."""
        if type(one) is not np.ndarray or one.base is None:
            return NotImplemented
        root = one
        while type(root.base) is np.ndarray:
            root = root.base
        if root.base is not None:
            # Of a kernel: several arrays may look at it, of which this pickle would make several.
            if self._owners.setdefault(id(root.base), root) is not root:
                raise pickle.PicklingError("two arrays over memory that is no array's")
            if root is one:
                return NotImplemented
        flat = root if root.flags.c_contiguous else root.T
        if not flat.flags.c_contiguous or root.dtype.hasobject:
            raise pickle.PicklingError("a view of an array with gaps")
        offset = one.__array_interface__["data"][0] - root.__array_interface__["data"][0]
        known = (one.shape, one.dtype, offset, one.strides, one.flags.writeable)
        return _view, (root, *known)


def _view(
    root: NDArray[Any], shape: tuple[int, ...], dtype: Any, offset: int, strides: tuple[int, ...],
    writeable: bool,
) -> NDArray[Any]:  # fmt: skip
    """Return an array over the memory of another."""
    flat = root if root.flags.c_contiguous else root.T
    made: NDArray[Any] = np.ndarray(shape, dtype, flat, offset, strides)
    if made.flags.writeable and not writeable:
        made.flags.writeable = False
    return made


class _Reader(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, shared: Sequence[Any]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, place: int) -> Any:
        """Return what is shared."""
        return self._shared[place]
