"""Of which files a kernel's compiled code is made: its own, and those of kernels that it calls.

Numba links a kernel into the cached code of its callers and looks whether the caller's file has
changed, not the callee's. After an update of one file callers in others would run the old code.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

_IMPORTS = re.compile(r"^from ([\w.]+) import", re.MULTILINE)
_KERNEL = re.compile(r"^@kernel\(|^@intrinsic", re.MULTILINE)


def sources_digest(module: str, file: str) -> bytes:
    """Return a digest of a module's source and of all that its kernels are linked with.

    Parameters
    ----------
    module
        Its absolute name.
    file
        Where its source is.
    """
    root = Path(file).resolve().parents[module.count(".")]
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(_linked(module, root, frozenset())):
        digest.update(name.encode() + b"\0" + _text(root / name).encode() + b"\0")
    return digest.digest()


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _linked(module: str, root: Path, before: frozenset[str]) -> frozenset[str]:
    """Return the files of a module and of the project's own that it imports, as paths below `root`.

    Of modules without kernels only constants are compiled in: what they import themselves does not
    count.
    """
    name = module.replace(".", "/") + ".py"
    path = root / name
    if name in before or not path.is_file():
        return before
    found = before | {name}
    if before and not _KERNEL.search(_text(path)):
        return found
    for imported in _IMPORTS.findall(_text(path)):
        found = _linked(imported, root, found)
    return found
