"""The tables of docs/lidar-maps.md: `python scripts/lidar_maps_page.py` makes them anew.

`scenarios/lidar_maps/compare_mappers.py --out DIR` writes DIR/figures.json; `--take FILE --command
"..."` keeps what it says of each world in `docs/results/lidar_maps` and makes the tables of these
worlds from it. Rows of a world of which nothing is kept stay as they are.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "lidar-maps.md"
KEPT = DOCS / "results" / "lidar_maps"

MAPPERS = {
    "calibrated": "Gaussian DEM, calibrated",
    "level": "Gaussian DEM, Eqs. 15-17",
    "quadtree": "quadtree",
}
# Above it the error of a claimed probability is called short.
MOST_ERROR = 0.03
World = dict[str, Any]
Row = list[str]


def number(value: float | None, form: str) -> str:
    """Return a number, a dash for none."""
    return "-" if value is None else format(value, form)


def interval(figure: list[float | None]) -> str:
    """Return a figure with its 95 % interval."""
    value, low, high = figure
    if value is None:
        return "-"
    return f"{value:.3f} [{number(low, '.3f')}, {number(high, '.3f')}]"


def landing_rows(world: World) -> list[Row]:
    """Return how flights ended, without the name of the world."""
    out = []
    for n, (way, f) in enumerate(world["landings"].items()):
        low, high = f["interval"]
        against = "" if n == 0 else f"{f['won']}, {f['lost']} ({f['p_value']:.2f})"
        out.append([
            way, str(f["flights"]), f"{f['landed'] / f['flights']:.2f} [{low:.2f}, {high:.2f}]",
            against, f"{f['divert_median_m']:.1f}", f"{f['propellant_median_kg']:.1f}",
        ])  # fmt: skip
    return out


def map_rows(world: World) -> list[Row]:
    """Return maps as a whole at both moments, time and memory."""
    out = []
    for mapper, f in world["maps"].items():
        for moment in ("first", "last"):
            if not (q := f[moment]):
                continue
            top = moment == "first"
            out.append([
                MAPPERS[mapper] if top else "", moment, interval(q["precision"]),
                interval(q["recall"]), f"{q['claimed']:.2f}", number(q["ece"], ".3f"),
                number(q["skill"], "+.2f"), f"{f['seconds']:.2f}" if top else "",
                f"{f['megabytes']:.1f}" if top else "",
            ])  # fmt: skip
    return out


def stratum_rows(world: World) -> list[Row]:
    """Return maps at the last decision by stratum of the true ground."""
    last = {MAPPERS[mapper]: f["last"] for mapper, f in world["maps"].items() if f["last"]}
    strata = dict.fromkeys(name for q in last.values() for name in q["strata"])
    out = []
    for stratum in strata:
        told = {m: s for m, q in last.items() if (s := q["strata"][stratum])["cells"]}
        for n, (mapper, s) in enumerate(told.items()):
            out.append([
                stratum if n == 0 else "", mapper, number(s["safe"], ".3f") if n == 0 else "",
                interval(s["precision"]), interval(s["recall"]), number(s["skill"], "+.2f"),
            ])  # fmt: skip
    return out


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


TABLES: dict[str, Callable[[World], list[Row]]] = {
    "landings": landing_rows, "maps": map_rows, "strata": stratum_rows,
}  # fmt: skip


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
        made = TABLES[name](figures["figures"])
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
    for name in TABLES:
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
