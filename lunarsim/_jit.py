"""Compile kernels with Numba, all by the same options.

Every kernel is cached, so it is compiled once per machine. NaN must survive because it means no
data; `fastmath` is therefore limited to flags that keep NaN and infinities.
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
from lunarsim._shares import Shared

# Threads that have done their share sleep, where the user has not said otherwise: those that spin
# until the next kernel take a fifth of the processor of a flight with cameras. It is read when the
# first kernel is spread over threads.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

F = TypeVar("F", bound=Callable[..., Any])

_FAST_FLAGS = {"contract", "reassoc", "nsz", "arcp"}
_FINITE_FLAGS = _FAST_FLAGS | {"nnan", "ninf"}


class _Inner(CPUDispatcher):  # type: ignore[misc]
    """A kernel without a wrapper for Python: calling it from there would end the process."""

    def __call__(self, *args: Any) -> Any:
        """Refuse."""
        raise TypeError(f"{self.py_func.__name__}: only kernels call it; see kernel(inner=False)")


_one_at_a_time = RLock()


@lru_cache(maxsize=1)
def _parallel_lock() -> AbstractContextManager[Any]:
    """Return the lock for parallel kernels; the layer "workqueue" aborts if two run at once."""
    numba.get_num_threads()  # starts the layer
    return _one_at_a_time if numba.threading_layer() == "workqueue" else nullcontext()


class _Parallel(CPUDispatcher):  # type: ignore[misc]
    """A kernel on several threads: safe to call in a forked process and from several threads."""

    def __call__(self, *args: Any) -> Any:
        """Run the kernel, or raise an error where that would end the process."""
        forks.check()
        with _parallel_lock():
            return super().__call__(*args)


def _without_warnings(function: F) -> F:
    """Return a function whose overflows and NaN raise no warnings, as in a compiled kernel."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*args, **kwargs)

    return cast(F, call)


@overload
def kernel(
    *, shared: Literal[True], allocates: bool = True
) -> Callable[[Callable[..., Any]], Callable[..., None]]: ...


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
    """Return a decorator that compiles a function with Numba.

    Parameters
    ----------
    parallel
        Spread `numba.prange` loops over threads. One iteration writes each output element.
    shared
        The same for a kernel with one such loop, compiled four times faster: its first parameter is
        a share (first turn, step) of that loop, which callers from Python omit. It returns nothing.
    fast
        Let the compiler reassociate sums and fuse multiply-adds, which it needs to vectorise.
    finite
        As `fast`, and promise that no NaN or infinity occurs: vectorises a running minimum.
    inline
        For scalar helpers that allocate nothing: compile into callers, fuse multiply-adds.
    exact
        As `inline`, without fusing: the bits are those of the helper's code in the caller.
    inner
        For kernels that only kernels call; they compile faster without a wrapper for Python. The
        default is kernels whose names begin with an underscore.
    allocates
        Without it no atomic operation counts each view of a row. `inline` and `exact` imply it.
    """
    flags = _FINITE_FLAGS if finite else _FAST_FLAGS if fast else {"contract"} if inline else False

    def decorate(function: Any) -> Any:
        if numba.config.DISABLE_JIT:
            plain = _without_warnings(function)
            return Shared(plain) if shared else plain
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
            compiled.__class__ = _Inner
        elif parallel:
            compiled.__class__ = _Parallel
        return Shared(compiled) if shared else compiled

    return decorate


prange = numba.prange


# So many microseconds of work repay the waking of threads.
_WORTH_THREADS = 256


@contextmanager
def threads_for(microseconds: float) -> Iterator[None]:
    """Let parallel kernels run on one thread where they have little work to share.

    Waking threads for a handful of rays takes longer than the rays, and on a busy machine a
    thousand times as long.

    Parameters
    ----------
    microseconds
        What the work takes on one thread, roughly: a ray one, a thousand sums of products one.
    """
    before = numba.get_num_threads()
    if microseconds >= _WORTH_THREADS or before == 1:
        yield
        return
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
