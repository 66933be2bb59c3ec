"""Scenes that were scanned and judged, kept in a file: to fit to them again takes no drawing.

The file is for one matrix of scenes. Whether the code still draws what is in it the first scene
tells: it is drawn again.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from zipfile import BadZipFile

import click
import numpy as np
from rich.console import Console
from worlds import Scene

from lunarsim.campaign.pool import gathered
from lunarsim.whole_files import write_whole


@dataclass(frozen=True)
class Judged:
    """Sites of one scene (n, ...); `features` float32, `cover` and `slope` choose the stratum.

    `ceiling` holds everywhere, `bound` outside the domain; where `doomed` they may be called surely
    unsafe.
    """

    scene: Scene
    features: np.ndarray
    known: np.ndarray
    ceiling: np.ndarray
    bound: np.ndarray
    slope: np.ndarray
    doomed: np.ndarray
    cover: float
    safe: np.ndarray


ARRAYS = ("features", "known", "ceiling", "bound", "slope", "doomed", "safe")


def judged_scenes(
    judge: Callable[[Scene], Judged],
    deck: list[Scene],
    file: Path | None,
    jobs: int,
    console: Console,
) -> list[Judged]:
    """Return scenes judged, from a file where it is there; else judge them, and write it.

    Raises
    ------
    click.ClickException
        If the file is another one: of other scenes, or of what is drawn otherwise now.
    """
    if file is None or not file.exists():
        judged = gathered(judge, deck, jobs, console, "scenes")
        if file is not None:
            _save(judged, file)
        return judged
    judged = _loaded(file)
    if [j.scene for j in judged] != deck:
        raise click.ClickException(f"{file} holds other scenes: delete it, or name another file")
    first = judge(deck[0])
    same = first.cover == judged[0].cover and all(
        np.array_equal(getattr(first, name), getattr(judged[0], name), equal_nan=True)
        for name in ARRAYS
    )
    if not same:
        raise click.ClickException(
            f"{file} was drawn by another version: its first scene comes out otherwise now; "
            "delete it, or name another file"
        )
    return judged


def _save(judged: list[Judged], file: Path) -> None:
    columns = {name: np.concatenate([getattr(j, name) for j in judged]) for name in ARRAYS}
    count = np.array([len(j.safe) for j in judged])
    scenes = json.dumps([asdict(j.scene) for j in judged])
    file.parent.mkdir(parents=True, exist_ok=True)

    def write(part: Path) -> None:
        with part.open("wb") as opened:
            np.savez_compressed(
                opened, count=count, cover=[j.cover for j in judged], scenes=scenes, **columns
            )

    write_whole(file, write)


def _loaded(file: Path) -> list[Judged]:
    try:
        with np.load(file) as data:
            scenes = [Scene(**scene) for scene in json.loads(str(data["scenes"]))]
            ends = np.cumsum(data["count"])[:-1]
            columns = [np.split(data[name], ends) for name in ARRAYS]
            covers = [float(cover) for cover in data["cover"]]
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise click.ClickException(f"{file} is no file of scenes ({error})") from None
    return [
        Judged(scene, *(column[n] for column in columns[:-1]), cover, columns[-1][n])
        for n, (scene, cover) in enumerate(zip(scenes, covers, strict=True))
    ]
