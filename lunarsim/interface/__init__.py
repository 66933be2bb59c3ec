"""Interface of external flight software: messages in C and Protobuf.

Programs in Python use `serve`; `allow_programs` lets scenarios run programs and libraries.
"""

from __future__ import annotations

from lunarsim._lazy import lazy_names

# Module of each public name, imported at first use; `__init__.pyi` has them for type checkers.
_MODULES = {
    "allow_programs": "lunarsim.parts.program_permission",
    "serve": "lunarsim.interface.server",
}
__all__ = sorted(_MODULES)  # noqa: PLE0605
__getattr__, __dir__ = lazy_names(__name__, _MODULES, globals())
