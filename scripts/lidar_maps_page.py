"""The tables of docs/lidar-maps.md: `python scripts/lidar_maps_page.py` makes them anew.

`scenarios/lidar_maps/compare_mappers.py --out DIR` writes DIR/figures.json; `--take FILE --command
"..."` keeps what it says of each world in `docs/results/lidar_maps` and makes the tables of these
worlds from it. Rows of a world of which nothing is kept stay as they are.
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
from rows import MAPPERS, ROWS, World

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "lidar-maps.md"
KEPT = DOCS / "results" / "lidar_maps"

# Above it the error of a claimed probability is called short.
MOST_ERROR = 0.03


def shortfalls(world: World) -> list[str]:
    """Return where a world's figures are not what one would wish, in words."""
    out = []
    for way, f in world["landings"].items():
        if f["landed"] < f["flights"]:
            out.append(f"{way}: {f['flights'] - f['landed']} of {f['flights']} not safe")
    for mapper, f in world["maps"].items():
        q = f["last"]
        if not q or not q["claimed"]:
            continue
        if q["ece"] is not None and q["ece"] > MOST_ERROR:
            out.append(f"{MAPPERS[mapper]}: claims with an error of {q['ece']:.3f}")
        if q["skill"] is not None and q["skill"] < 0.0:
            out.append(f"{MAPPERS[mapper]}: claims with a skill of {q['skill']:+.2f}")
    return out


def mark(name: str) -> str:
    """Return the line before what is made."""
    return f"<!-- {name}: made by scripts/lidar_maps_page.py -->"


def _table(text: str, name: str, kept: dict[str, World]) -> str:
    """Return a page with the rows of the kept worlds made anew in one of its tables."""
    pattern = re.compile(re.escape(mark(name)) + r"\n\n((?:\|.*\n)+)")
    found = pattern.search(text)
    if found is None:
        raise click.ClickException(f"{PAGE.name}: no table follows {mark(name)}")
    head, rule, *rows = found[1].splitlines()
    groups: dict[str, list[str]] = {}
    for row in rows:
        world = row.split("|")[1].strip()
        if world:
            groups[world] = []
        groups[next(reversed(groups))].append(row)
    for world, figures in kept.items():
        made = ROWS[name](figures["figures"])
        groups[world] = [
            "| " + " | ".join([world if n == 0 else "", *row]) + " |" for n, row in enumerate(made)
        ]
    lines = [head, rule, *(row for group in groups.values() for row in group)]
    return text[: found.start(1)] + "\n".join(lines) + "\n" + text[found.end(1) :]


def _commands(text: str, kept: dict[str, World]) -> str:
    """Return a page with the commands of the kept worlds, and where these fall short."""
    pattern = re.compile(re.escape(mark("commands")) + r"\n\n((?:- .*\n)*)")
    found = pattern.search(text)
    if found is None:
        raise click.ClickException(f"{PAGE.name}: no list follows {mark('commands')}")
    lines = []
    for world, figures in kept.items():
        short = "; ".join(shortfalls(figures["figures"])) or "nowhere"
        lines.append(f"- {world}: `{figures['command']}`. Short: {short}.\n")
    return text[: found.start(1)] + "".join(lines) + text[found.end(1) :]


def made(text: str, kept: dict[str, World]) -> str:
    """Return the page with all that is made of what is kept."""
    for name in ROWS:
        text = _table(text, name, kept)
    return _commands(text, kept)


def load() -> dict[str, World]:
    """Return what is kept by world."""
    files = [json.loads(p.read_text(encoding="utf-8")) for p in sorted(KEPT.glob("*.json"))]
    return {file["world"]: file for file in files}


def finite(data: Any) -> Any:
    """Return data with None in place of what is no number."""
    if isinstance(data, dict):
        return {key: finite(value) for key, value in data.items()}
    if isinstance(data, list):
        return [finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def take(found: dict[str, Any], command: str) -> None:
    """Keep what the study wrote, a file a world."""
    KEPT.mkdir(parents=True, exist_ok=True)
    for world, figures in found.items():
        name = re.sub(r"[^a-z0-9]+", "_", world.lower()).strip("_")
        file = {"world": world, "command": command, "figures": finite(figures)}
        text = json.dumps(file, indent=1, allow_nan=False) + "\n"
        (KEPT / f"{name}.json").write_text(text, encoding="utf-8")


@click.command()
@click.option("--take", "taken", type=click.Path(path_type=Path, exists=True), default=None,
              help="figures.json that the study wrote.")  # fmt: skip
@click.option("--command", default="", help="That wrote it.")
def main(taken: Path | None, command: str) -> None:
    """Make the tables of the page anew, of what is kept and of what is taken."""
    if taken is not None:
        if not command:
            raise click.UsageError("--command: the command that wrote it")
        take(json.loads(taken.read_text(encoding="utf-8")), command)
    PAGE.write_text(made(PAGE.read_text(encoding="utf-8"), load()), encoding="utf-8")


if __name__ == "__main__":
    main()
