"""Find the studies in the folder of supplied scenarios, and load one of them."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from pathlib import Path

from lunarsim.errors import InputError, suggestion
from lunarsim.scenario.shipped import folder
from lunarsim.studies.study import Study


def study_files() -> dict[str, Path]:
    """Return the scripts that declare a study, by name; no script is run."""
    root = folder()
    found = {}
    for path in sorted([*root.glob("*.py"), *root.glob("*/*.py")]):
        if re.search(r"^study\b.*= Study\(", path.read_text(encoding="utf-8"), re.MULTILINE):
            found[str(path.relative_to(root).with_suffix(""))] = path
    return found


def summary(path: Path) -> str:
    """Return the first line of a script's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.split("\n", maxsplit=1)[0]


def _forget_other_folders(folder: Path, studies: set[Path]) -> None:
    """Remove modules of other folders of studies, because some have the same names."""
    others = {path.parent for path in studies} - {folder}
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if file is not None and Path(file).parent in others:
            del sys.modules[name]


def load_study(name: str) -> Study:
    """Load the study of a name, for instance "landers/slosh".

    Raises
    ------
    InputError
        If there is no study of that name.
    """
    files = study_files()
    if name not in files:
        raise InputError(
            "study", name, "must be the name of a study",
            f"{suggestion(name, files)} List them with `lunarsim study list`.",
        )  # fmt: skip
    path = files[name]
    # Scripts import others of their folder, and their processes import them by name.
    sys.path.insert(0, str(path.parent))
    _forget_other_folders(path.parent, set(files.values()))
    study = importlib.import_module(path.stem).study
    if not isinstance(study, Study):
        raise TypeError(f"{path}: `study` must be a Study, got {type(study).__name__}")
    return study
