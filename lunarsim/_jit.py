"""Compile kernels with Numba, with the same options everywhere.

Every kernel is cached, so it is compiled once per machine. NaN marks missing data and must be
preserved; `fastmath` is therefore limited to flags that keep NaN and infinities.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import lru_cache, wraps
from threading import RLock
from typing import Any, Literal, TypeVar, cast, overload

import numba
import numpy as np
from numba.core.registry import CPUDispatcher

from lunarsim import forks
from lunarsim._kernel_cache import enable_cache
from lunarsim._work_partition import MIN_THREADED_WORK_US, PartitionedKernel

# Idle OpenMP threads sleep instead of spinning until the next kernel; spinning threads use a fifth
# of the processor time of a flight with cameras. OpenMP reads this at the first parallel kernel.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

F = TypeVar("F", bound=Callable[..., Any])

_FAST_FLAGS = {"contract", "reassoc", "nsz", "arcp"}
_FINITE_FLAGS = _FAST_FLAGS | {"nnan", "ninf"}


class _InternalKernel(CPUDispatcher):  # type: ignore[misc]
    """Compiled kernel without a Python wrapper, which only kernels can call."""

    def __call__(self, *args: Any) -> Any:
        """Raise an error: only compiled kernels can call this function."""
        raise TypeError(
            f"{self.py_func.__name__}: only kernels can call this. Use kernel(inner=False) to call "
            "it from Python."
        )


_one_at_a_time = RLock()


@lru_cache(maxsize=1)
def _parallel_lock() -> AbstractContextManager[Any]:
    """Return the lock that a parallel kernel must hold while it runs.

    The threading layer "workqueue" aborts if two parallel kernels run at the same time.
    """
    numba.get_num_threads()  # starts the layer
    return _one_at_a_time if numba.threading_layer() == "workqueue" else nullcontext()


class _ParallelKernel(CPUDispatcher):  # type: ignore[misc]
    """Parallel kernel that is safe in forked processes and with Python threads."""

    def __call__(self, *args: Any) -> Any:
        """Run the kernel, or raise an error if running it would end the process."""
        forks.check()
        with _parallel_lock():
            return super().__call__(*args)


def _without_warnings(function: F) -> F:
    """Return a function that runs without NumPy warnings about overflow and NaN.

    Compiled kernels do not warn either.
    """

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*args, **kwargs)

    return cast(F, call)


@overload
def kernel(
    *, shared: Literal[True], allocates: bool = True
) -> Callable[[Callable[..., Any]], PartitionedKernel]: ...


@overload
def kernel(
    *,
    parallel: bool = False,
    fast: bool = False,
    finite: bool = False,
    inline: bool = False,
    exact: bool = False,
    inner: bool | None = None,
    allocates: bool = True,
) -> Callable[[F], F]: ...


def kernel(
    *,
    parallel: bool = False,
    shared: bool = False,
    fast: bool = False,
    finite: bool = False,
    inline: bool = False,
    exact: bool = False,
    inner: bool | None = None,
    allocates: bool = True,
) -> Callable[[Any], Any]:
    """Return a decorator that compiles a numerical function (kernel) with Numba.

    Parameters
    ----------
    parallel
        Distribute `numba.prange` loops over threads. Only one iteration may write an output
        element.
    shared
        Run a kernel with one parallel loop on Python threads. This compiles four times faster than
        `parallel`. The kernel's first parameter is its slice of the loop (first index, step);
        callers from Python omit it. The kernel returns nothing.
    fast
        Let the compiler reassociate sums and fuse multiply-adds, which vectorisation needs.
    finite
        Like `fast`, and also assume that no NaN or infinity occurs. This vectorises a running
        minimum.
    inline
        For scalar helpers that allocate nothing: inline into callers and fuse multiply-adds.
    exact
        Like `inline`, but without fused multiply-adds, so that results are bitwise the same.
    inner
        For kernels that only kernels call; they compile faster without a Python wrapper. Default:
        true for names that begin with an underscore.
    allocates
        If false, views of array rows are not reference-counted (an atomic operation each). `inline`
        and `exact` imply false.
    """
    flags = _FINITE_FLAGS if finite else _FAST_FLAGS if fast else {"contract"} if inline else False

    def decorate(function: Any) -> Any:
        if numba.config.DISABLE_JIT:
            plain = _without_warnings(function)
            return PartitionedKernel(plain) if shared else plain
        closed = function.__name__.startswith("_") and not shared if inner is None else inner
        compiled = numba.njit(
            nogil=True,
            error_model="numpy",
            no_cfunc_wrapper=True,
            no_cpython_wrapper=closed,
            parallel=parallel,
            fastmath=flags,
            **({"forceinline": True} if inline or exact else {}),
            **({} if allocates and not (inline or exact) else {"_nrt": False}),
        )(function)
        enable_cache(compiled, function)
        if closed:
            compiled.__class__ = _InternalKernel
        elif parallel:
            compiled.__class__ = _ParallelKernel
        return PartitionedKernel(compiled) if shared else compiled

    return decorate


prange = numba.prange


@contextmanager
def threads_for(microseconds: float) -> Iterator[None]:
    """Run parallel kernels in a `with` block on one thread if they have little work.

    `microseconds` is the approximate duration of the work on one thread. Kernels on Python threads
    (`shared`) have `PartitionedKernel.run_loop` for this.
    """
    before = numba.get_num_threads()
    if microseconds >= MIN_THREADED_WORK_US or before == 1:
        yield
        return
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
