"""One place that says how kernels are compiled.

Every kernel is cached beside its module, so the compilation is paid once a machine. NaN must
survive (it means no data), so `fastmath` is limited to flags that keep NaN and infinities.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, TypeVar, overload

import numba
from numba.core.registry import CPUDispatcher

from lunarsim._kernel_sources import sources_digest
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


def _stamp(compiled: Any, function: Any) -> None:
    """Let what is cached hold only for the present source of all that it is linked with.

    A stamp of a kernel's own file is all that Numba looks at.
    """
    cached = compiled._cache._cache_file
    linked = sources_digest(function.__module__)
    cached._source_stamp = cached._source_stamp, linked


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
        Spread `numba.prange` loops over threads. Kernels write each output element from one
        iteration alone, so the bits do not depend on the number of threads.
    shared
        The same for a kernel with one such loop, and four times sooner compiled: its first
        parameter is a share (first turn, step) of that loop, which callers from Python leave out.
        It writes into arrays that it is given.
    fast
        Let the compiler reassociate sums and fuse multiply-adds, which it needs to vectorise.
    finite
        As `fast`, and promise that no NaN or infinity occurs, which it needs to vectorise a
        running minimum or maximum.
    inline
        For scalar helpers in the innermost loops, which allocate nothing: compile them into
        their callers, fuse multiply-adds.
    exact
        As `inline`, without fusing: the bits are those of the caller with the helper written out.
    inner
        For kernels that only kernels call: without the wrapper that takes arguments from Python,
        they are sooner compiled. Left out, those are it whose names begin with an underscore.
    allocates
        Without it references to arrays are not counted: each view of a row counts by an atomic
        operation, for which threads wait on each other. `inline` and `exact` imply it.
    """
    flags = _FINITE_FLAGS if finite else _FAST_FLAGS if fast else {"contract"} if inline else False

    def decorate(function: Any) -> Any:
        closed = function.__name__.startswith("_") and not shared if inner is None else inner
        compiled = numba.njit(
            cache=True,
            nogil=True,
            error_model="numpy",
            no_cfunc_wrapper=True,
            no_cpython_wrapper=closed,
            parallel=parallel,
            fastmath=flags,
            **({"forceinline": True} if inline or exact else {}),
            **({} if allocates and not (inline or exact) else {"_nrt": False}),
        )(function)
        _stamp(compiled, function)
        if closed:
            compiled.__class__ = _Inner
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
