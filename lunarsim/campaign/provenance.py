"""Identify the code, files, packages and machine behind results."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

import lunarsim

# Packages whose versions may change results.
_PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "casadi", "opencv-python-headless", "moderngl",
             "rasterio", "pyarrow")  # fmt: skip

# Differences that do not prevent resuming a campaign. Processors round differently, but only
# recording this keeps clusters of different machines usable.
IGNORED_DIFFERENCES = ("python", "cores", "processor")


def bytes_digest(data: bytes) -> str:
    """Return the SHA-256 digest of bytes, which detects damaged result files."""
    return hashlib.sha256(data).hexdigest()


@cache
def code_digest() -> str:
    """Return a digest of lunarsim's source files, which identifies the code."""
    root = Path(lunarsim.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if path.suffix in (".py", ".json", ".glsl", ".npz") and "__pycache__" not in path.parts:
            digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def file_digests(data: Any) -> dict[str, str]:
    """Return the digest of each file named in nested tables, by file name.

    The tables `data` may be those of a scenario. Their keys that end in ``path`` name files; files
    that do not exist are omitted.
    """
    named = [text for key, text in _strings(data) if key.endswith("path") and Path(text).is_file()]
    return {text: _file_digest(Path(text)) for text in named}


def part_digests(data: Any) -> dict[str, str]:
    """Return digests of the source files of external components, by module.

    An external component has a ``kind`` of the form "module:Class" in the nested tables `data`.
    """
    found: dict[str, str] = {}
    for key, text in _strings(data):
        if key == "kind" and ":" in text:
            found |= module_digest(text.partition(":")[0])
    return found


def _strings(data: Any) -> Iterator[tuple[str, str]]:
    """Yield key and value of every string in nested tables and lists."""
    items = data.items() if isinstance(data, Mapping) else enumerate(data)
    for key, value in items:
        if isinstance(value, Mapping | list | tuple):
            yield from _strings(value)
        elif isinstance(value, str):
            yield str(key), value


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def module_digest(name: str) -> dict[str, str]:
    """Return the digest of the source file of an external module, by module name.

    The result is empty for a module of lunarsim or one without a source file.
    """
    source = getattr(sys.modules.get(name), "__file__", None)
    if name.partition(".")[0] == "lunarsim" or source is None or not Path(source).is_file():
        return {}
    return {name: _file_digest(Path(source))}


def environment_differences(first: Mapping[str, str], second: Mapping[str, str]) -> list[str]:
    """Return the names of packages and settings that differ between two environments.

    Only differences that may change results are listed. `first` and `second` are results of
    `environment` on two machines.
    """
    names = dict.fromkeys([*first, *second])
    return [n for n in names if n not in IGNORED_DIFFERENCES and first.get(n) != second.get(n)]


def environment() -> dict[str, str]:
    """Return interpreter, platform, processor and package versions, by name."""
    packages = {}
    for name in _PACKAGES:
        try:
            packages[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "python": platform.python_version(),
        "platform": f"{sys.platform} {platform.machine()}",
        "cores": str(os.cpu_count()),
        "processor": os.environ.get("NUMBA_CPU_NAME") or get_host_cpu_name(),
        **packages,
    }
