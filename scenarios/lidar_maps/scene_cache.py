"""Store the evaluated sites of simulated scenes in a file for repeated fits.

The file is valid for one matrix of scenes. To detect changed code, the first scene is generated
again and compared.
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
from worlds import LidarScene

from lunarsim.atomic_files import atomic_write
from lunarsim.campaign.pool import collect_results
from lunarsim.onboard.calibration.evidence import CalibrationEvidence


@dataclass(frozen=True)
class SceneSites:
    """Evaluated landing sites of one scene: inputs of the calibration and true safety.

    `features` (n, features) are the inputs of the calibrated probability, `known` (n,) whether a
    site is in its domain. `observed_terrain_bound` (n,) is an upper bound of p_safe everywhere,
    `outside_domain_bound` (n,) only outside the domain. Only sites with `may_be_claimed_unsafe`
    (n,) may be classified as certainly unsafe. `slope` (n,), the nominal slope over its limit, and
    `rough_fraction`, the estimated fraction of terrain above the roughness limit, select the
    stratum; `safe` (n,) is the truth.
    """

    scene: LidarScene
    features: np.ndarray
    known: np.ndarray
    observed_terrain_bound: np.ndarray
    outside_domain_bound: np.ndarray
    slope: np.ndarray
    may_be_claimed_unsafe: np.ndarray
    rough_fraction: float
    safe: np.ndarray

    @classmethod
    def of(
        cls, scene: LidarScene, evidence: CalibrationEvidence, where: np.ndarray, safe: np.ndarray
    ) -> SceneSites:
        """Collect the sites of a scene in the mask `where`.

        `safe` (n,) is the true safety of these sites.
        """
        e = evidence
        return cls(
            scene,
            e.features(where).astype(np.float32),
            e.in_domain[where],
            np.minimum(e.observed_terrain_bound(), e.p_no_rock_under_pads())[where],
            e.outside_domain_bound()[where],
            e.slope[where],
            e.may_be_claimed_unsafe[where],
            float(e.curve.at(e.lander.roughness_limit)),
            safe,
        )


ARRAYS = (
    "features",
    "known",
    "observed_terrain_bound",
    "outside_domain_bound",
    "slope",
    "may_be_claimed_unsafe",
    "safe",
)
# Keys of the file that differ from the attributes; `rough_fraction` has the key "cover".
_KEYS = {"may_be_claimed_unsafe": "doomed"}


def load_or_evaluate(
    evaluate: Callable[[LidarScene], SceneSites],
    scenes: list[LidarScene],
    file: Path | None,
    jobs: int,
    console: Console,
) -> list[SceneSites]:
    """Read evaluated scenes from a file; if it is missing, compute and write them.

    `evaluate` maps one scene and evaluates its sites.

    Raises
    ------
    click.ClickException
        If the file holds other scenes, or was computed with different code.
    """
    if file is None or not file.exists():
        evaluated = collect_results(evaluate, scenes, jobs, console, "scenes")
        if file is not None:
            _save(evaluated, file)
        return evaluated
    evaluated = _load(file)
    if [j.scene for j in evaluated] != scenes:
        raise click.ClickException(f"{file} holds other scenes. Delete it or choose another file.")
    first = evaluate(scenes[0])
    same = first.rough_fraction == evaluated[0].rough_fraction and all(
        np.array_equal(getattr(first, name), getattr(evaluated[0], name), equal_nan=True)
        for name in ARRAYS
    )
    if not same:
        raise click.ClickException(
            f"{file} was computed by another version: its first scene differs. "
            "Delete it or choose another file."
        )
    return evaluated


def _save(evaluated: list[SceneSites], file: Path) -> None:
    """Write evaluated scenes to a compressed NumPy file."""
    columns = {
        _KEYS.get(name, name): np.concatenate([getattr(j, name) for j in evaluated])
        for name in ARRAYS
    }
    count = np.array([len(j.safe) for j in evaluated])
    scenes = json.dumps([asdict(j.scene) for j in evaluated])
    file.parent.mkdir(parents=True, exist_ok=True)

    def write(part: Path) -> None:
        with part.open("wb") as opened:
            np.savez_compressed(
                opened,
                count=count,
                cover=[j.rough_fraction for j in evaluated],
                scenes=scenes,
                **columns,
            )

    atomic_write(file, write)


def _load(file: Path) -> list[SceneSites]:
    """Read evaluated scenes from a compressed NumPy file."""
    try:
        with np.load(file) as data:
            scenes = [LidarScene(**scene) for scene in json.loads(str(data["scenes"]))]
            ends = np.cumsum(data["count"])[:-1]
            columns = [np.split(data[_KEYS.get(name, name)], ends) for name in ARRAYS]
            covers = [float(cover) for cover in data["cover"]]
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise click.ClickException(f"{file} is not a file of scenes ({error})") from None
    return [
        SceneSites(scene, *(column[n] for column in columns[:-1]), cover, columns[-1][n])
        for n, (scene, cover) in enumerate(zip(scenes, covers, strict=True))
    ]
