"""Generate a Minari data set of minimum-propellant descents: states and thrusts.

Starts are random within the range of an approach of the default lander (`StartDistribution`). Each
descent is solved by `lunarsim.optimal` under the limits of the guidance law `optimal`. Shards
(files) of `SHARD` descents are saved when they are done, so an interrupted run resumes; the data
set is written from all shards. The same seed gives identical results for any number of processes.
Infeasible starts are counted and omitted.

An episode holds the nodes of one descent: position of the lander relative to the end of the
approach (3,), m, velocity (3,), m/s, both ENU, and mass, kg. The action is the thrust over mass
(3,), m/s^2, held until the next node; the reward is minus the propellant of the interval, kg. The
infos hold the remaining time of the descent, s ("time_to_go").

    python scenarios/learning/optimal_descents.py --descents 1000 --out build/descents
    python scenarios/learning/optimal_descents.py --descents 100000 --jobs 2 --out build/descents

Read it with ``minari.MinariDataset("build/descents/data")``; the extra `data` installs Minari.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
import zipfile
import zlib
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from rich.console import Console

from lunarsim import Scenario, __version__
from lunarsim.atomic_files import atomic_write, atomic_write_text, remove_contents_on_error
from lunarsim.campaign.pool import iterate_results
from lunarsim.console import plain_console, plain_progress
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.optimal_law import OptimalLaw
from lunarsim.optimal.errors import InfeasibleError, SolverError
from lunarsim.optimal.final_time import minimize_propellant
from lunarsim.optimal.planner import Planner
from lunarsim.optimal.problem import Descent

Array = NDArray[np.float64]

SHARD = 250
PROBLEM = "problem.json"  # limits under which the shards in its folder were solved
_APEX_DEPTH_M = 0.5  # glideslope apex below the end point, m; the same as in the guidance laws
# Number of columns of an observation and of an action.
OBSERVED, COMMANDED = 7, 3
# Arrays of a shard.
KEPT = ("observations", "actions", "duration", "propellant", "out_of_reach", "failed")


@dataclass(frozen=True)
class DescentShardTask:
    """Settings of one shard (file) of solved descents.

    `number` is the number of the shard, `count` that of its descents, `seed` the root seed and
    `intervals` the number of constant-thrust intervals per descent.
    """

    number: int
    count: int
    seed: int
    intervals: int


@dataclass(frozen=True)
class StartDistribution:
    """Uniform distribution of the start states of an approach.

    Attributes
    ----------
    height, aside
        Height above the end point, and horizontal distance from it, m.
    elevation
        Minimum elevation angle of the start as seen from the end point, deg.
    closing
        Horizontal distance divided by the horizontal speed towards the end point, s.
    across, sink
        Lateral speed across the path, and descent rate, m/s.
    load
        Propellant in excess of the reserve, as a fraction of full tanks.
    """

    height: tuple[float, float] = (15.0, 800.0)
    aside: tuple[float, float] = (0.0, 1000.0)
    elevation: float = 15.0
    closing: tuple[float, float] = (12.0, 60.0)
    across: tuple[float, float] = (-10.0, 10.0)
    sink: tuple[float, float] = (0.0, 35.0)
    load: tuple[float, float] = (0.3, 1.0)

    @classmethod
    def key(cls, task: DescentShardTask) -> str:
        """Return a digest of start distribution, shard settings and lunarsim version.

        The digest is part of the file name of the shard.
        """
        identity = {"starts": asdict(cls()), "task": asdict(task), "release": __version__}
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array, float]:
        """Sample a start: position (3,), m, velocity (3,), m/s, and propellant.

        The position is relative to the end of the approach. The propellant is the amount above the
        reserve, as a fraction of full tanks.
        """
        while True:
            height, aside = rng.uniform(*self.height), rng.uniform(*self.aside)
            if height >= aside * np.tan(np.deg2rad(self.elevation)):
                break
        turn = rng.uniform(0.0, 2.0 * np.pi)
        along = np.array([np.cos(turn), np.sin(turn), 0.0])
        left = np.array([-along[1], along[0], 0.0])
        speed = -aside / rng.uniform(*self.closing)
        velocity = speed * along + rng.uniform(*self.across) * left
        velocity[2] = -rng.uniform(*self.sink)
        return aside * along + [0.0, 0.0, height], velocity, rng.uniform(*self.load)


@cache
def _default_scenario() -> Scenario:
    """Return the scenario of the default lander."""
    return Scenario.from_dict({"name": "descents"})


def problem_of(displacement: Array, velocity: Array, propellant_fraction: float) -> Descent:
    """Return the minimum-propellant problem of the default lander from a start.

    `displacement` (3,) is from the end of the approach, m; `velocity` (3,) is in m/s;
    `propellant_fraction` is the propellant above the reserve as a fraction of full tanks. The
    limits are those of the guidance law `optimal`.
    """
    scenario = _default_scenario()
    lander, approach, law = scenario.vehicle.make(), Approach(), OptimalLaw()
    dry = lander.dry_mass + approach.reserve
    return Descent(
        displacement, velocity, dry + propellant_fraction * (lander.wet_mass - dry), np.zeros(3),
        np.array([0.0, 0.0, -approach.vertical_speed]), scenario.gravity_m_s2,
        *approach.limits.thrust_range(lander), lander.exhaust_velocity, dry,
        approach.max_tilt, approach.glideslope, _APEX_DEPTH_M,
        max_final_tilt=law.max_final_tilt, tilt_rate=law.tilt_rate,
    )  # fmt: skip


def solve_shard(task: DescentShardTask) -> dict[str, Array]:
    """Solve random minimum-propellant descents for one shard (file).

    Returns "observations" (k, N + 1, 7), "actions" (k, N, 3), "duration" (k,), s, and "propellant"
    (k,), kg, of the k feasible descents, and the numbers of infeasible starts ("out_of_reach") and
    of solver failures ("failed").
    """
    rng = np.random.default_rng(np.random.SeedSequence(task.seed, spawn_key=(task.number,)))
    planner, starts = Planner(task.intervals), StartDistribution()
    seen, done, times, spent = [], [], [], []
    out_of_reach = failed = 0
    while len(seen) < task.count:
        try:
            path = minimize_propellant(planner, problem_of(*starts.draw(rng)))
        except InfeasibleError:
            out_of_reach += 1
            continue
        except SolverError:
            failed += 1
            continue
        seen.append(np.column_stack((path.position, path.velocity, path.mass)))
        done.append(path.thrust_acceleration)
        times.append(path.duration)
        spent.append(path.propellant)
    return {
        "observations": np.array(seen), "actions": np.array(done), "duration": np.array(times),
        "propellant": np.array(spent), "out_of_reach": np.array(out_of_reach),
        "failed": np.array(failed),
    }  # fmt: skip


def solve_all(
    tasks: list[DescentShardTask], folder: Path, jobs: int, console: Console
) -> list[Path]:
    """Solve the shards whose files are missing in a folder; return all files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{task.number:05d}-{StartDistribution.key(task)}.npz" for task in tasks]
    todo = [k for k, file in enumerate(files) if not file.exists()]
    with plain_progress(console) as progress:
        bar = progress.add_task("shards", total=len(tasks), completed=len(tasks) - len(todo))
        for at, shard in iterate_results(solve_shard, [tasks[k] for k in todo], jobs):
            atomic_write(files[todo[at]], lambda part, shard=shard: _save_shard(part, shard))
            progress.advance(bar)
    return files


def read_shard(file: Path) -> dict[str, Array]:
    """Read a shard (file) of solved descents.

    Raises
    ------
    click.UsageError
        If the file is not a complete shard.
    """
    try:
        with np.load(file, allow_pickle=False) as held:
            return {name: held[name] for name in KEPT}
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise click.UsageError(
            f"{file} is not a complete shard ({error}). Delete it and run optimal_descents.py "
            f"again."
        ) from None


def check_limits(folder: Path, remedy: str = "Use another folder for --out.") -> None:
    """Reject a folder whose shards (files of descents) were solved under other limits.

    Raises
    ------
    click.UsageError
        If the limits differ or their file is invalid; `remedy` is the end of the message.
    """
    file = folder / PROBLEM
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise click.UsageError(
            f"{file} is not a valid file of limits ({error}). {remedy}"
        ) from None
    if stored != _limits():
        raise click.UsageError(
            f"The shards in {folder} were solved with other limits of the descent, as "
            f"{file.name} states. {remedy}"
        )


def _limits() -> dict[str, Any]:
    """Return the fields of an example descent problem, for JSON.

    All problems share its limits (thrust, tilt, glideslope), gravity and lander parameters; a
    stored file with other values shows that shards were solved under other limits.
    """
    asked = asdict(problem_of(np.array([100.0, 0.0, 100.0]), np.array([0.0, 0.0, -5.0]), 1.0))
    asked = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asked.items()}
    return json.loads(json.dumps(asked))  # type: ignore[no-any-return]


def _write_limits(folder: Path) -> None:
    """Write the limits of the descent problems into a folder of shards.

    If the folder already has a file of other limits, a `click.UsageError` is raised.
    """
    if (folder / PROBLEM).exists():
        check_limits(folder)
        return
    folder.mkdir(parents=True, exist_ok=True)
    atomic_write_text(folder / PROBLEM, json.dumps(_limits(), indent=1) + "\n")


def _save_shard(path: Path, shard: dict[str, Array]) -> None:
    """Write a shard to a compressed NumPy file."""
    with path.open("wb") as file:
        np.savez_compressed(file, **shard)


def write_dataset(
    files: list[Path], folder: Path, task: DescentShardTask, console: Console
) -> dict[str, Any]:
    """Write all shards as one Minari data set; return its summary values.

    They are, for example, numbers of descents and percentiles of propellant. `task` gives the
    settings that all shards have in common.
    """
    import minari
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    figures = {"descents": 0, "out_of_reach": 0, "failed": 0}
    spent, digest = [], hashlib.sha256()
    # Minari cannot reopen its files from a relative path.
    storage = MinariStorage.new(
        folder.absolute(), Box(-np.inf, np.inf, (OBSERVED,), np.float64),
        Box(-np.inf, np.inf, (COMMANDED,), np.float64), data_format="hdf5",
    )  # fmt: skip
    with plain_progress(console) as progress:
        for file in progress.track(files, description="writing"):
            shard = read_shard(file)
            storage.update_episodes(_episodes(shard, figures["descents"], EpisodeBuffer))
            figures["descents"] += len(shard["duration"])
            figures["out_of_reach"] += int(shard["out_of_reach"])
            figures["failed"] += int(shard["failed"])
            spent.append(shard["propellant"])
            digest.update(np.ascontiguousarray(shard["observations"]).tobytes())
            digest.update(np.ascontiguousarray(shard["actions"]).tobytes())
    kg = np.concatenate(spent)
    figures |= {
        "propellant_kg": [float(v) for v in np.percentile(kg, (5, 50, 95))],
        "seed": task.seed, "intervals": task.intervals, "sha256": digest.hexdigest(),
    }  # fmt: skip
    storage.update_metadata(
        {
            "dataset_id": "lunarsim/optimal-descents-v0",
            "algorithm_name": "lossless convexification, best final time",
            "description": "Minimum-propellant descents of the default lander of lunarsim",
            "author": {"lunarsim"}, "minari_version": minari.__version__,
            "lunarsim_version": __version__,
            "starts": json.dumps(asdict(StartDistribution())), "figures": json.dumps(figures),
        }
    )  # fmt: skip
    return figures


def _write_dataset_atomically(
    files: list[Path], target: Path, task: DescentShardTask, console: Console
) -> dict[str, Any]:
    """Write the data set to a temporary folder; rename it to `target` when complete.

    Returns the summary values of the data set.
    """
    part = target.with_name(f".{target.name}.part")
    if part.exists():
        shutil.rmtree(part)
    with remove_contents_on_error(part):
        part.mkdir(parents=True)
        figures = write_dataset(files, part, task, console)
    if target.exists():
        target.rmdir()  # empty: checked by the caller
    part.rename(target)
    return figures


def _episodes(shard: Any, first: int, buffer_class: Any) -> list[Any]:
    """Return the Minari episodes of a shard.

    `first` is the number of the first episode, `buffer_class` the class of Minari's episode
    buffers.
    """
    out = []
    for k, (seen, done) in enumerate(zip(shard["observations"], shard["actions"], strict=True)):
        ends = np.arange(len(done)) == len(done) - 1
        left = np.linspace(float(shard["duration"][k]), 0.0, len(seen))
        out.append(
            buffer_class(
                id=first + k, observations=seen, actions=done, rewards=np.diff(seen[:, 6]),
                terminations=ends, truncations=np.zeros(len(done), bool),
                infos={"time_to_go": left},
            )
        )  # fmt: skip
    return out


@click.command()
@click.option("--descents", type=click.IntRange(min=1), default=1000, show_default=True,
              help="Number of descents to store; infeasible descents do not count.")  # fmt: skip
@click.option("--intervals", type=click.IntRange(8, 200), default=40, show_default=True,
              help="Number of time intervals with constant thrust in each descent.")  # fmt: skip
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True,
              help="Folder for the parts of the data set (shards) and for the complete data set, "
              "`data`.")  # fmt: skip
def main(descents: int, intervals: int, seed: int, jobs: int, out: Path) -> None:
    """Solve minimum-propellant descents and write them as a Minari data set."""
    console = plain_console(110, soft_wrap=True)
    if importlib.util.find_spec("minari") is None or importlib.util.find_spec("h5py") is None:
        raise click.UsageError("The package minari or h5py is missing. Install the extra `data`.")
    data = out / "data"
    if data.exists() and any(data.iterdir()):
        raise click.UsageError(f"--out: must be a folder without a data set, but contains {data}")
    full, rest = divmod(descents, SHARD)
    counts = [SHARD] * full + [rest] * (rest > 0)
    tasks = [DescentShardTask(k, count, seed, intervals) for k, count in enumerate(counts)]
    try:
        _write_limits(out / "shards")
        files = solve_all(tasks, out / "shards", jobs, console)
        figures = _write_dataset_atomically(files, data, tasks[0], console)
        atomic_write_text(out / "figures.json", json.dumps(figures, indent=1) + "\n")
    except KeyboardInterrupt:
        raise click.ClickException(
            f"Interrupted. Finished shards are saved in {out / 'shards'}; "
            "run the same command again to resume."
        ) from None
    except OSError as error:  # no writable folder, or a full disk
        raise click.ClickException(
            f"--out: {error}, got '{out}'. Finished shards are saved; run the same command to "
            f"resume."
        ) from None
    low, middle, high = figures["propellant_kg"]
    console.print(
        f"{figures['descents']} descents in {data}, propellant {middle:.1f} kg ({low:.1f} to "
        f"{high:.1f}, 90 %); {figures['out_of_reach']} infeasible starts; the solver "
        f"failed on {figures['failed']}; sha256 {figures['sha256'][:16]}"
    )


if __name__ == "__main__":
    main()
