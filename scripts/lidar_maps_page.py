"""Update the tables of docs/validation/lidar-maps.md: `python scripts/lidar_maps_page.py`.

`scenarios/lidar_maps/compare_mappers.py --out DIR` writes DIR/figures.json. `--store FILE --command
"..."` stores its results by world in `docs/results/lidar_maps` and updates the rows of these
worlds. A world is one terrain of the study. Rows of worlds without stored results stay unchanged.
"""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).parents[1] / "scenarios" / "lidar_maps"))
from comparison_rows import MAPPERS, ROWS, WorldResults

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "lidar-maps.md"
STORED = DOCS / "results" / "lidar_maps"

# Calibration error above which a claimed probability counts as a shortfall.
MAX_CALIBRATION_ERROR = 0.03


def shortfalls(world: WorldResults) -> list[str]:
    """Return the requirements that the results of one terrain do not meet, as texts.

    They are flights without a safe landing, and maps whose claimed probabilities have a calibration
    error above `MAX_CALIBRATION_ERROR` or a negative skill.
    """
    out = []
    for way, f in world["landings"].items():
        if f["landed"] < f["flights"]:
            out.append(f"{way}: {f['flights'] - f['landed']} of {f['flights']} not safe")
    for mapper, f in world["maps"].items():
        q = f["last"]
        if not q or not q["claimed"]:
            continue
        if q["ece"] is not None and q["ece"] > MAX_CALIBRATION_ERROR:
            out.append(f"{MAPPERS[mapper]}: claims with an error of {q['ece']:.3f}")
        if q["skill"] is not None and q["skill"] < 0.0:
            out.append(f"{MAPPERS[mapper]}: claims with a skill of {q['skill']:+.2f}")
    return out


def mark(name: str) -> str:
    """Return the comment line before the generated table `name` in the page."""
    return f"<!-- {name}: made by scripts/lidar_maps_page.py -->"


def _table(text: str, name: str, stored: dict[str, WorldResults]) -> str:
    """Return the page `text` with updated rows in the table `name`.

    `stored` has the stored results by world.
    """
    pattern = re.compile(re.escape(mark(name)) + r"\n\n((?:\|.*\n)+)")
    found = pattern.search(text)
    if found is None:
        raise click.ClickException(f"{PAGE.name}: must contain a table after {mark(name)}")
    head, rule, *rows = found[1].splitlines()
    groups: dict[str, list[str]] = {}
    for row in rows:
        world = row.split("|")[1].strip()
        if world:
            groups[world] = []
        groups[next(reversed(groups))].append(row)
    for world, figures in stored.items():
        new_rows = ROWS[name](figures["figures"])
        groups[world] = [
            "| " + " | ".join([world if n == 0 else "", *row]) + " |"
            for n, row in enumerate(new_rows)
        ]
    lines = [head, rule, *(row for group in groups.values() for row in group)]
    return text[: found.start(1)] + "\n".join(lines) + "\n" + text[found.end(1) :]


def _commands(text: str, stored: dict[str, WorldResults]) -> str:
    """Return the page `text` with an updated list of commands and unmet requirements.

    `stored` has the stored results by world.
    """
    pattern = re.compile(re.escape(mark("commands")) + r"\n\n((?:- .*\n)*)")
    found = pattern.search(text)
    if found is None:
        raise click.ClickException(f"{PAGE.name}: must contain a list after {mark('commands')}")
    lines = []
    for world, figures in stored.items():
        short = "; ".join(shortfalls(figures["figures"])) or "none"
        lines.append(f"- {world}: `{figures['command']}`. Shortfalls: {short}.\n")
    return text[: found.start(1)] + "".join(lines) + text[found.end(1) :]


def update_page(text: str, stored: dict[str, WorldResults]) -> str:
    """Return the page `text` with tables updated from the `stored` results by world."""
    for name in ROWS:
        text = _table(text, name, stored)
    return _commands(text, stored)


def load() -> dict[str, WorldResults]:
    """Read the stored results of the study, by world."""
    files = [json.loads(p.read_text(encoding="utf-8")) for p in sorted(STORED.glob("*.json"))]
    return {file["world"]: file for file in files}


def finite(data: Any) -> Any:
    """Replace non-finite numbers in nested data by None, for JSON."""
    if isinstance(data, dict):
        return {key: finite(value) for key, value in data.items()}
    if isinstance(data, list):
        return [finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def store(results: dict[str, Any], command: str) -> None:
    """Store the results of the study by world, with the command, one file per world."""
    STORED.mkdir(parents=True, exist_ok=True)
    for world, figures in results.items():
        name = re.sub(r"[^a-z0-9]+", "_", world.lower()).strip("_")
        file = {"world": world, "command": command, "figures": finite(figures)}
        text = json.dumps(file, indent=1, allow_nan=False) + "\n"
        (STORED / f"{name}.json").write_text(text, encoding="utf-8")


@click.command()
@click.option("--store", "results_file", type=click.Path(path_type=Path, exists=True), default=None,
              help="File figures.json of the study.")  # fmt: skip
@click.option("--command", default="", help="Command that wrote the file.")
def main(results_file: Path | None, command: str) -> None:
    """Update the tables of docs/validation/lidar-maps.md; optionally store new results."""
    if results_file is not None:
        if not command:
            raise click.UsageError("--command: must be given with --store")
        store(json.loads(results_file.read_text(encoding="utf-8")), command)
    PAGE.write_text(update_page(PAGE.read_text(encoding="utf-8"), load()), encoding="utf-8")


if __name__ == "__main__":
    main()
