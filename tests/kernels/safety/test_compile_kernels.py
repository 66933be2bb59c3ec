"""The kernels that are compiled in advance."""

from __future__ import annotations

import numpy as np

from lunarsim.safety import _exact_kernels, _kernels, _plane_kernels
from lunarsim.safety.compile_kernels import compile_safety_kernels


def test_warming_compiles_what_maps_call(monkeypatch):
    called = []
    for module, name in (
        (_kernels, "stochastic"), (_kernels, "footprint_extremes"),
        (_plane_kernels, "stochastic_planes"),
        (_plane_kernels, "bounded"), (_exact_kernels, "exact"),
    ):  # fmt: skip
        inner = getattr(module, name)

        def seen(*args, inner=inner, name=name):
            called.append((name, next(a.dtype for a in args if isinstance(a, np.ndarray))))
            return inner(*args)

        monkeypatch.setattr(module, name, seen)
    compile_safety_kernels(exact=False)
    assert {name for name, _ in called} == {
        "stochastic",
        "footprint_extremes",
        "stochastic_planes",
        "bounded",
    }
    compile_safety_kernels(exact=True)
    assert called[-1] == ("exact", np.float64)
