"""Run mutation tests: put faults into kernels and count those that tests detect.

    python scripts/mutants.py                                   # a sample over all kernels
    python scripts/mutants.py --only triangulation --count 20
    python scripts/mutants.py --only rocks/_kernels.py:88       # every fault of one line
    python scripts/mutants.py --list --only rocks               # print the faults, run nothing

A fault (mutant) is one small change at one place (`mutant_parts/faults.py`), with the name
`file:line:column:operator`. It is made in a copy of the package in a temporary folder. Only the
tests that cover the file run there, up to the first failure. Every fault needs a compilation.

The results are stored as JSON lines in the file `--results`. An interrupted run resumes from this
file. Results are repeated if the file of the fault has changed, or if a survivor's tests have.
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
from mutant_parts.equivalent import BrokenListError, EquivalentMutant, load_equivalents
from mutant_parts.faults import Mutant, faults_of, kernel_lines, sample_faults
from mutant_parts.run import MutationRun
from mutant_parts.trial import CAUGHT, BrokenTestsError
from rich.table import Table

from lunarsim.console import plain_console, plain_progress

ROOT = Path(__file__).resolve().parent.parent
EQUIVALENT = ROOT / "scripts" / "mutants_equivalent.toml"
MIN_CAUGHT_FRACTION = 0.95
MIN_FAULTS_PER_FILE = 2
INTERRUPTED = 130

# Kernel files whose tests are not those of the mirrored folder; the tests of the kernels themselves
# come first.
_TESTS: dict[str, tuple[str, ...]] = {
    "lunarsim/_frame_kernels.py": ("tests/kernels/test_frames.py", "tests/test_frames.py"),
    "lunarsim/models/_pinhole_kernels.py": (
        "tests/kernels/models/test_pinhole.py",
        "tests/models/test_pinhole.py",
    ),
    "lunarsim/onboard/control/_kernels.py": (
        "tests/onboard/control",
        "tests/simulation/test_cycle.py",
    ),
    "lunarsim/onboard/hazards/shadows/_evidence_kernels.py": (
        "tests/kernels/onboard/hazards/shadows/test_evidence.py",
        "tests/onboard/hazards/shadows/test_evidence.py",
    ),
    "lunarsim/onboard/hazards/shadows/_lit_tile_kernels.py": (
        "tests/kernels/onboard/hazards/shadows/test_lit_tiles.py",
    ),
    "lunarsim/onboard/hazards/shadows/_probability_kernels.py": (
        "tests/kernels/onboard/hazards/shadows/test_probability_map.py",
        "tests/onboard/hazards/shadows/test_probability_map.py",
        "tests/kernels/onboard/hazards/shadows/test_probability.py",
        "tests/onboard/hazards/shadows/test_probability.py",
        "tests/kernels/onboard/hazards/shadows/test_evidence.py",
        "tests/onboard/hazards/shadows/test_evidence.py",
    ),
    "lunarsim/onboard/navigation/_kriging_kernels.py": (
        "tests/kernels/onboard/navigation/test_kriging.py",
        "tests/kernels/onboard/navigation/test_nearest.py",
    ),
    "lunarsim/onboard/navigation/_inertial_kernels.py": (
        "tests/kernels/onboard/navigation/test_inertial.py",
        "tests/onboard/navigation/test_inertial.py",
    ),
    "lunarsim/onboard/navigation/_registration_kernels.py": (
        "tests/kernels/onboard/navigation/test_registration.py",
        "tests/onboard/navigation/test_registration.py",
        "tests/onboard/navigation/test_seen_scan.py",
    ),
    "lunarsim/onboard/navigation/_rock_filter_kernels.py": (
        "tests/kernels/onboard/navigation/test_rock_filter.py",
        "tests/kernels/onboard/navigation/test_schmidt_kalman_covariance.py",
        "tests/onboard/navigation/test_rock_filter.py",
    ),
    "lunarsim/onboard/perception/_image_quality_kernels.py": (
        "tests/kernels/onboard/perception/test_high_sun.py",
        "tests/onboard/perception/test_health.py",
        "tests/kernels/onboard/perception/test_edges.py",
        "tests/onboard/perception/test_edges.py",
    ),
    "lunarsim/onboard/perception/_patch_kernels.py": (
        "tests/kernels/onboard/perception/test_patches.py",
        "tests/kernels/onboard/perception/test_detector.py",
        "tests/onboard/perception/test_detector.py",
    ),
    "lunarsim/rocks/_kernels.py": (
        "tests/kernels/rocks/test_kernels.py",
        "tests/rocks/test_level_ground.py",
    ),
    "lunarsim/sensors/_detector_kernels.py": ("tests/sensors/test_detector.py",),
    "lunarsim/sensors/_imu_kernels.py": (
        "tests/kernels/test_frames.py",
        "tests/simulation/test_cycle.py",
    ),
    "lunarsim/sensors/rendering/_cull_kernels.py": (
        "tests/kernels/sensors/rendering/test_cull.py",
    ),
    "lunarsim/sensors/rendering/_scattered_light_kernels.py": (
        "tests/kernels/sensors/rendering/test_glow.py",
        "tests/sensors/rendering/test_glow.py",
    ),
    "lunarsim/sensors/rendering/_rock_tile_kernels.py": (
        "tests/kernels/sensors/rendering/test_rock_tiles.py",
    ),
    "lunarsim/sensors/rendering/_small_rock_kernels.py": (
        "tests/kernels/sensors/rendering/test_small_rocks.py",
        "tests/kernels/sensors/rendering/test_kernels.py",
    ),
    "lunarsim/sensors/rendering/_tile_kernels.py": (
        "tests/kernels/sensors/rendering/test_tile_tables.py",
        "tests/kernels/sensors/rendering/test_kernels.py",
        "tests/kernels/sensors/rendering/test_lee_blocks.py",
    ),
    "lunarsim/onboard/calibration/_monotone_spline_kernels.py": (
        "tests/onboard/calibration/test_ensemble.py",
    ),
    "lunarsim/simulation/_cycle_kernels.py": ("tests/simulation/test_cycle.py",),
    "lunarsim/vehicle/_kernels.py": (
        "tests/kernels/vehicle/test_kernels.py",
        "tests/vehicle/test_dynamics.py",
        "tests/kernels/vehicle/test_actuators.py",
        "tests/vehicle/test_actuators.py",
    ),
    "lunarsim/vehicle/_leg_kernels.py": (
        "tests/kernels/vehicle/test_legs.py",
        "tests/vehicle/test_legs.py",
    ),
    "lunarsim/core/candidates.py": (
        "tests/onboard/policies/test_candidates.py",
        "tests/onboard/policies/test_expected_miss.py",
    ),
    "lunarsim/core/divert.py": (
        "tests/kernels/core/test_divert.py",
        "tests/onboard/guidance/test_divert.py",
        "tests/onboard/guidance/test_held_times.py",
    ),
    "lunarsim/core/feedback.py": (
        "tests/onboard/guidance/test_laws_from_equations.py",
        "tests/onboard/guidance/test_laws.py",
    ),
    "lunarsim/core/guidance.py": (
        "tests/onboard/guidance/test_vertical.py",
        "tests/onboard/guidance/test_strain.py",
        "tests/onboard/guidance/test_following.py",
    ),
    "lunarsim/core/path_cost.py": (
        "tests/kernels/core/test_divert.py",
        "tests/onboard/guidance/test_laws.py",
    ),
    "lunarsim/core/touchdown.py": (
        "tests/kernels/core/test_touchdown.py",
        "tests/vehicle/test_touchdown.py",
    ),
    "envs/lunarsim_envs/descent/_kernels.py": (
        "tests/kernels/envs/test_descent_kernels.py",
        "tests/envs/test_descent_kernels.py",
        "tests/envs/test_descent.py",
    ),
    "envs/lunarsim_envs/descent/_loop_kernels.py": (
        "tests/kernels/envs/test_descent_kernels.py",
        "tests/envs/test_descent_kernels.py",
    ),
    "envs/lunarsim_envs/descent/_reward_kernels.py": (
        "tests/kernels/envs/test_reward_kernels.py",
        "tests/kernels/envs/test_potential.py",
    ),
    "envs/lunarsim_envs/sites/_beyond_kernels.py": (
        "tests/kernels/envs/test_site_choice.py",
        "tests/envs/test_site_choice.py",
        "tests/kernels/envs/test_out_of_reach.py",
    ),
    "envs/lunarsim_envs/sites/_choice_kernels.py": (
        "tests/kernels/envs/test_site_kernels.py",
        "tests/kernels/envs/test_site_choice.py",
        "tests/envs/test_site_choice.py",
    ),
    "envs/lunarsim_envs/sites/_flight_kernels.py": ("tests/kernels/envs/test_site_kernels.py",),
    "envs/lunarsim_envs/sites/_map_kernels.py": (
        "tests/kernels/envs/test_site_kernels.py",
        "tests/envs/test_sites.py",
    ),
    "envs/lunarsim_envs/sites/_sparse_kernels.py": ("tests/kernels/envs/test_site_kernels.py",),
    "envs/lunarsim_envs/sites/reachable_candidates.py": ("tests/envs/test_site_reach.py",),
    "lunarsim/world/terrain/_crater_kernels.py": (
        "tests/kernels/world/terrain/test_craters.py",
        "tests/world/terrain/test_craters.py",
        "tests/world/terrain/test_hazard_field.py",
    ),
    "lunarsim/world/terrain/_placement_kernels.py": (
        "tests/rocks/test_field.py",
        "tests/world/terrain",
    ),
    "lunarsim/world/terrain/_ray_kernels.py": (
        "tests/world/terrain/test_rays.py",
        "tests/world/terrain/test_terrain.py",
    ),
    "lunarsim/world/terrain/_surface_kernels.py": (
        "tests/kernels/world/terrain/test_surface.py",
        "tests/world/terrain/test_surface.py",
    ),
}


def tests_of(path: str) -> list[str]:
    """Return the tests of a kernel file: in `_TESTS`, or folders of the same name.

    Raises
    ------
    BrokenTestsError
        If a test file does not exist.
    """
    mirrored = "tests" + path.removeprefix("lunarsim").rpartition("/")[0]
    folders = (mirrored.replace("tests", "tests/kernels", 1), mirrored)
    existing = tuple(folder for folder in folders if (ROOT / folder).exists())
    found = list(_TESTS.get(path, existing or (mirrored,)))
    for test in found:
        if not (ROOT / test).exists():
            raise BrokenTestsError(f"{test}: must exist, because it contains the tests of {path}")
    return found


def kernel_files() -> dict[str, str]:
    """Return the text of each file with kernels, by its path from the root."""
    texts = {
        p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8")
        for part in ("lunarsim", "envs")
        for p in sorted((ROOT / part).rglob("*.py"))
    }
    return {path: text for path, text in texts.items() if kernel_lines(text)}


def faults_per_file(lines: dict[str, int], count: int) -> dict[str, int]:
    """Distribute about `count` faults over files in proportion to their kernel lines.

    `lines` and the result have a number for each file; every file gets two faults or more.
    """
    total = sum(lines.values())
    return {path: max(MIN_FAULTS_PER_FILE, round(count * n / total)) for path, n in lines.items()}


def select_faults(
    texts: dict[str, str], only: str, count: int, seed: int, equivalents: list[EquivalentMutant]
) -> tuple[list[Mutant], list[tuple[Mutant, str]], list[EquivalentMutant]]:
    """Select the faults (mutants) to try, without those known to change no result.

    Returns the faults to try, the selected equivalent faults with the reason why they change no
    result, and the entries of `equivalents` that match no fault.

    Parameters
    ----------
    texts
        Source of the kernel files.
    only
        Part of the fault names to select. With `file:line`, all faults of the line are selected.
    count, seed
        Number of faults to sample over all files, and the random seed.
    equivalents
        Known equivalent faults.
    """
    everything = {path: faults_of(path, text) for path, text in texts.items()}
    flat = [fault for faults in everything.values() for fault in faults]
    reasons: dict[Mutant, str] = {}
    stale = []
    for entry in equivalents:
        fault = entry.match(flat)
        if fault is None:
            stale.append(entry)
        else:
            reasons[fault] = entry.reason
    wanted = {p: [f for f in faults if only in f.name] for p, faults in everything.items()}
    wanted = {path: faults for path, faults in wanted.items() if faults}
    if ".py:" in only:
        picked = [fault for faults in wanted.values() for fault in faults]
    else:
        share = faults_per_file({path: kernel_lines(texts[path]) for path in wanted}, count)
        picked = [
            f for path, faults in wanted.items() for f in sample_faults(faults, share[path], seed)
        ]
    tried = [fault for fault in picked if fault not in reasons]
    return tried, [(f, reasons[f]) for f in picked if f in reasons], stale


def _summary(faults: list[Mutant], trials: MutationRun, listed: list[tuple[Mutant, str]]) -> Table:
    """Return the table of results by file: numbers of faults by outcome, and time.

    `faults` were to be tried, `trials` has their results, and `listed` are equivalent faults.
    """
    columns = ("faults", "caught", "survived", "not compiled", "equivalent", "time (min)")
    table = Table("file", *columns, title="Mutation test results")
    rows: dict[str, list[float]] = {}
    for fault in faults:
        row = rows.setdefault(fault.path, [0] * 6)
        result = trials.known(fault)
        if result is not None:
            row[0] += result.verdict != "refused"
            row[1] += result.verdict in CAUGHT
            row[2] += result.verdict == "survived"
            row[3] += result.verdict == "refused"
            row[5] += result.seconds / 60.0
    for fault, _ in listed:
        rows.setdefault(fault.path, [0] * 6)[4] += 1
    total = [sum(column) for column in zip(*rows.values(), strict=True)]
    for path, row in [*sorted(rows.items()), ("all", total)]:
        table.add_row(path, *(f"{n:.0f}" for n in row[:5]), f"{row[5]:.1f}")
    return table


def _report(
    faults: list[Mutant],
    trials: MutationRun,
    listed: list[tuple[Mutant, str]],
    texts: dict[str, str],
) -> bool:
    """Print the table and the surviving faults; return whether enough are caught.

    `texts` is the source by file; other arguments as in `_summary`. 95 % must be caught.
    """
    console = plain_console(None if sys.stdout.isatty() else 120)
    console.print(_summary(faults, trials, listed))
    for title, outcome in (("survived", "survived"), ("not compiled", "refused")):
        for fault in faults:
            result = trials.known(fault)
            if result is not None and result.verdict == outcome:
                click.echo(f"{title}: {fault.name}")
                if outcome == "survived":
                    click.echo(f"    {fault.code}\n    {fault.line_after(texts[fault.path])}")
    for fault, reason in listed:
        click.echo(f"equivalent: {fault.name}\n    {fault.code}\n    {reason}")
    verdicts = [r.verdict for f in faults if (r := trials.known(f)) and r.verdict != "refused"]
    caught = sum(v in CAUGHT for v in verdicts)
    if not verdicts:
        click.echo("no fault was tried")
        return False
    share = caught / len(verdicts)
    click.echo(
        f"{caught} of {len(verdicts)} faults caught: {100.0 * share:.1f} %, "
        f"{100.0 * caught / (len(verdicts) + len(listed)):.1f} % including the equivalent ones"
    )
    return share >= MIN_CAUGHT_FRACTION


@click.command(context_settings={"show_default": True})
@click.option(
    "--only", default="", help="Use only faults whose name contains this text. Default: all faults."
)
@click.option(
    "--count",
    default=240,
    type=click.IntRange(1),
    help="Number of faults to select, over all files.",
)
@click.option("--seed", default=1, help="Random seed of the selection of faults.")
@click.option(
    "--jobs",
    default=1,
    type=click.IntRange(1),
    help="Number of faults that are tested in parallel.",
)
@click.option(
    "--limit",
    default=600.0,
    type=click.FloatRange(1.0),
    help="Time limit of the test of one fault (s).",
)
@click.option(
    "--results", default=ROOT / "out" / "mutants.jsonl",
    help="File in which the results are stored (.jsonl).",
    type=click.Path(path_type=Path, dir_okay=False),
)  # fmt: skip
@click.option(
    "--resume/--restart",
    default=True,
    help="Whether to continue from the stored results or to delete them.",
)
@click.option(
    "--list", "show", is_flag=True, help="Print the selected faults without running them."
)
def main(
    only: str, count: int, seed: int, jobs: int, limit: float, results: Path, resume: bool,
    show: bool,
) -> None:  # fmt: skip
    """Put faults into the kernels and print those that no test detects.

    The exit status is 1 if less than 95 % are caught, without the equivalent faults listed in
    mutants_equivalent.toml. Faults that Numba does not compile are not counted.
    """
    texts = kernel_files()
    try:
        faults, listed, stale = select_faults(
            texts, only, count, seed, load_equivalents(EQUIVALENT)
        )
        tests = {path: tests_of(path) for path in sorted({f.path for f in faults})}
        if not faults and not listed:
            raise click.BadParameter(
                f"must be part of a fault name, got {only!r}", param_hint="--only"
            )
        results.parent.mkdir(parents=True, exist_ok=True)
        if not resume:
            results.unlink(missing_ok=True)
        trials = MutationRun(ROOT, results, tests)
    except (BrokenListError, BrokenTestsError, ValueError, OSError) as error:
        raise click.UsageError(str(error)) from error
    for entry in stale:
        click.echo(f"{EQUIVALENT.name}: entry matches no fault: {entry.fault}", err=True)
    if show:
        for fault in faults:
            click.echo(f"{fault.name}\n    {fault.code}\n    {fault.line_after(texts[fault.path])}")
        return
    try:
        _run_trials(faults, trials, jobs, limit)
    except BrokenTestsError as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        _report(faults, trials, listed, texts)
        click.echo(f"Interrupted. The results are stored in {results}.", err=True)
        sys.exit(INTERRUPTED)
    if not _report(faults, trials, listed, texts):
        sys.exit(1)


def _run_trials(faults: list[Mutant], trials: MutationRun, jobs: int, limit: float) -> None:
    """Try the faults that have no stored result, with a progress bar.

    `jobs` is the number of parallel trials and `limit` the time limit of each, s.
    """
    left = [fault for fault in faults if trials.known(fault) is None]
    with plain_progress(plain_console(stderr=True)) as bar:
        task = bar.add_task("faults", total=len(faults), completed=len(faults) - len(left))
        if left:
            trials.run(left, jobs, limit, lambda _: bar.advance(task))


if __name__ == "__main__":
    main()
