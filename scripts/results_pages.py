"""Fill marked blocks of documentation pages from stored results: `make results`.

A block is a table with a last line on its source:

    <!-- results: NAME table=1 columns=1,3 rows=1,2 -->
    <!-- end results -->

NAME is a file docs/results/NAME.json; several names give one table after another. `table` is the
number of a table in the report of a study (default: 1), or a name in the `ROWS` of
scenarios/lidar_maps/comparison_rows.py, or "shortfalls". `columns` and `rows` select by number. A
block keeps its heading row; a new block gets the headings of the study.

`--store NAME FILE` stores the part of a study's results.json that pages show: every metric by seed
if NAME begins with by_seed/, metrics by world (with figures.json beside FILE) if it is lidar_maps,
else the tables of the report. `--check` lists the pages that are not current, with exit code 1.
"""

from __future__ import annotations

import importlib
import json
import math
import re
import shlex
import statistics
import sys
from collections.abc import Callable, Iterator, Sequence
from math import prod
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from lunarsim.errors import InputError, error_reason
from lunarsim.studies.command import report_study
from lunarsim.studies.library import load_study, study_files
from lunarsim.studies.results import script_digest

DOCS = Path(__file__).resolve().parents[1] / "docs"
STORED = DOCS / "results"
sys.path.insert(0, str(DOCS.parent / "scenarios" / "lidar_maps"))
comparison = importlib.import_module("comparison_rows")

OPENING, END = "<!-- results: ", "<!-- end results -->"
BLOCK = re.compile(rf"^{OPENING}([^\n]*) -->\n(.*?)^{END}$", re.MULTILINE | re.DOTALL)
_REMEDY = "Correct the opening line of the block."
# Calibration error above which a calibrated probability counts as a shortfall.
MAX_CALIBRATION_ERROR = 0.03

Data = dict[str, Any]
TableRows = list[list[str]]


def metric(
    label: str,
    values: Sequence[float | None],
    unit: str = "",
    paper: float | None = None,
    better: str = "",
) -> Data:
    """Return one metric: a finite value per seed, and a reference value.

    `paper` is the value of the paper, or the optimum. `better` is "higher", "lower", or "" if
    neither is better.
    """
    finite = [float(v) for v in values if v is not None and math.isfinite(v)]
    return {"label": label, "unit": unit, "values": finite, "paper": paper, "better": better}


def gaussian_dem(rows: list[Data]) -> Iterator[Data]:
    """Yield metrics by field of the study of the Gaussian DEM.

    They are precision and recall by terrain complexity (Table 3 of the paper), and the minimum
    precision and recall of nine scans, with the threshold p > 0.5 (Table 6).
    """
    table_3 = [row for row in rows if row["table"] == "3"]
    for c in dict.fromkeys(row["c"] for row in table_3):
        of_c = [row for row in table_3 if row["c"] == c]
        precision, recall, bounded = (
            [row[name] for row in of_c] for name in ("precision", "recall", "bounded")
        )
        at = f"Table 3, c = {c:g}: "
        yield metric(f"{at}precision", precision, "", 1.0, "higher")
        yield metric(f"{at}recall", recall, "", of_c[0]["paper"], "higher")
        yield metric(f"{at}recall of `bounded_safety`", bounded)
    table_6: dict[int, list[Data]] = {}
    for row in rows:
        if row["table"] == "6":
            table_6.setdefault(row["number"], []).append(row["at_half"])
    for name in ("proposed slope", "proposed roughness"):
        for k, word in enumerate(("precision", "recall")):
            worst = [
                min(v for scan in scans if math.isfinite(v := scan[name][k]))
                for scans in table_6.values()
            ]
            yield metric(f"Table 6, {name}, minimum {word} of nine scans", worst)


def quadtree(rows: list[Data]) -> Iterator[Data]:
    """Yield map errors, hazard areas and sites of each flight at its last evaluation."""
    yield metric("time of the lock", [flight["lock"] for flight in rows], "s")
    last = [flight["evaluations"][-1] for flight in rows]
    yield metric("map error, RMS", [e["map_error_rms"] for e in last], "m", 0.5, "lower")
    yield metric("slope error, maximum", [e["slope_error_max"] for e in last], "deg", 6.0, "lower")
    missed = [e["missed_m2"] / max(e["hazard_m2"], 1e-9) for e in last]
    yield metric("missed fraction of the hazard area", missed)
    yield metric("false hazard area", [e["false_m2"] for e in last], "m2")
    sites = [e["sites"] for e in last]
    yield metric("ranked sites", [len(s) for s in sites])
    yield metric("exactly safe sites", [sum(one["exactly_safe"] for one in s) for s in sites])
    hazards = [sum(one["hazard_m2"] > 0.0 for one in s) for s in sites]
    yield metric("landing zones with a true hazard", hazards, "", 0.0, "lower")


# Map rates at 50 m: label, values of the paper for both paths, and the better direction.
_RATES = {
    "clear_recall": ("clear area classified as clear", (0.11, 0.29), "higher"),
    "clear_false": ("hazard fraction of the area classified as clear", (0.0, 0.0), "lower"),
    "occupied_correct": ("hazard fraction of the area classified as occupied", (0.85, 0.85),
                         "higher"),
}  # fmt: skip


def shadows(rows: list[Data]) -> Iterator[Data]:
    """Yield map rates at 50 m altitude, propellant and duration on both descent paths."""
    flown = {path: [f for f in rows if f["path"] == path] for path in ("nominal", "modified")}
    for rate, (label, papers, better) in _RATES.items():
        for (path, flights), paper in zip(flown.items(), papers, strict=True):
            values = [f["levels"]["50.0"]["rates"][rate] for f in flights]
            yield metric(f"{label}, {path}", values, "", paper, better)
    for name, unit, paper in (("propellant", "kg", 1.0), ("duration", "s", 2.0)):
        for path, flights in flown.items():
            yield metric(f"{name}, {path}", [f[name] for f in flights], unit)
        pairs = zip(flown["nominal"], flown["modified"], strict=True)
        more = [b[name] - a[name] for a, b in pairs]
        yield metric(f"{name}, modified minus nominal", more, unit, paper, "lower")


def real_returns(rows: list[Data]) -> Iterator[Data]:
    """Yield height accuracy at held-out LiDAR returns, by split of the returns.

    The map has the settings of flights, then those of Table 6 of the Gaussian DEM paper.
    """
    for name in ("as flights do", "field of Table 6"):
        wanted = {"returns": "terrain returns", "map": name, "slope": "all"}.items()
        splits = [row for row in rows if wanted <= row.items()]
        for key, label, unit in (
            ("rmse", "RMSE", "m"),
            ("nees", "mean square of error / predicted sigma (ideal 1)", ""),
            ("beyond2", "fraction beyond 2 sigma (ideal 0.046)", ""),
        ):
            yield metric(f"{name}: {label}", [split[key] for split in splits], unit)


def guidance(rows: list[Data]) -> Iterator[Data]:
    """Yield excess propellant, velocity error and safe landings by guidance law."""
    for law in dict.fromkeys(row["law"] for row in rows):
        mine = [row for row in rows if row["law"] == law]
        over = [100.0 * (row["total"] / (row["optimum"] + row["descent"]) - 1.0) for row in mine]
        yield metric(f"`{law}`: excess propellant to touchdown", over, "%", 0.0)
        speed = [row["speed"] for row in mine]
        yield metric(f"`{law}`: velocity error at the end of the approach", speed, "m/s")
        yield metric(f"`{law}`: safe landings", [row["safe"] for row in mine])


def navigation(rows: list[Data]) -> Iterator[Data]:
    """Yield filter consistency (NEES, NIS), position errors and landing outcomes."""
    for part in rows[0]["nees"]:
        values = [f["nees"][part] for f in rows]
        yield metric(f"NEES / degrees of freedom, {part} (ideal 1)", values)
    for kind in sorted({kind for f in rows for kind in f["nis"]}):
        values = [f["nis"].get(kind) for f in rows]
        yield metric(f"NIS / degrees of freedom, {kind} (ideal 1)", values)
    for key, label, unit in (
        ("start_error", "initial position error", "m"),
        ("map_error", "position error at touchdown", "m"),
        ("lost", "navigation lost at the end", ""),
        ("safe", "safe landings", ""),
    ):
        yield metric(label, [f[key] for f in rows], unit)


# Metrics by seed of each study that is stored below by_seed/.
METRICS: dict[str, Callable[[list[Data]], Iterator[Data]]] = {
    "gaussian_dem/tables": gaussian_dem, "quadtree/hazard_field": quadtree,
    "shadows/nominal_vs_modified": shadows, "real_returns/airborne": real_returns,
    "guidance/propellant": guidance, "navigation/consistency": navigation,
}  # fmt: skip


def shortfalls(world: Data) -> list[str]:
    """Return the requirements that the metrics of one terrain do not meet, as texts.

    They are flights without a safe landing, and maps whose calibrated probabilities have a
    calibration error above `MAX_CALIBRATION_ERROR` or a negative skill.
    """
    out = []
    for way, f in world["landings"].items():
        if f["landed"] < f["flights"]:
            out.append(f"{way}: {f['flights'] - f['landed']} of {f['flights']} not safe")
    for mapper, f in world["maps"].items():
        q = f["last"]
        if not q or not q["claimed"]:
            continue
        texts = []
        if q["ece"] is not None and q["ece"] > MAX_CALIBRATION_ERROR:
            texts.append(f"ECE {q['ece']:.3f}")
        if q["skill"] is not None and q["skill"] < 0.0:
            texts.append(f"Brier skill {q['skill']:+.2f}")
        if texts:
            out.append(f"{comparison.MAPPERS[mapper]}: {', '.join(texts)}")
    return out


def _seed_rows(metrics: list[Data]) -> Iterator[list[str]]:
    """Yield a table row per metric; a mean that is worse than the paper is in italics."""
    for m in metrics:
        values, paper, mean = m["values"], m["paper"], statistics.fmean(m["values"])
        text = f"{mean:.4g}"
        if paper is not None and (mean < paper if m["better"] == "higher" else mean > paper):
            text = f"*{text}*" if m["better"] else text
        yield [
            f"{m['label']} ({m['unit']})" if m["unit"] else m["label"], text,
            f"{min(values):.4g} to {max(values):.4g}", str(len(values)),
            "" if paper is None else f"{paper:.4g}",
        ]  # fmt: skip


def table_of(stored: Data, name: str) -> tuple[list[str], TableRows]:
    """Return headings and rows of a table in a stored file; `name` is as in a block."""
    if "metrics" in stored:
        return ["metric", "mean", "range", "seeds", "paper"], list(_seed_rows(stored["metrics"]))
    if "world" in stored:
        world = stored["figures"]
        if name == "shortfalls":
            rows = [["; ".join(shortfalls(world)) or "none"]]
        elif name in comparison.ROWS:
            rows = comparison.ROWS[name](world)
        else:
            names = ", ".join([*comparison.ROWS, "shortfalls"])
            raise InputError("table", name, f"must be one of {names}", _REMEDY)
        rows = [[stored["world"] if n == 0 else "", *row] for n, row in enumerate(rows)]
        return ["world", *[""] * (len(rows[0]) - 1)], rows
    (table,) = _selected("table", stored["tables"], name)
    return table["columns"], table["rows"]


def source_line(stored: Data) -> str:
    """Return what a stored file holds on its origin, and what it lacks."""
    parts = [f"command `{stored['command']}`"] if stored.get("command") else []
    if stored.get("commit"):
        parts.append(f"made at commit `{stored['commit']}`")
        path = study_files().get(stored["study"])
        if stored.get("script") and (path is None or script_digest(path) != stored["script"]):
            parts[-1] += "; the study's code has changed since"
    if stored.get("date"):
        parts.append(f"date {stored['date']}")
    if machine := stored.get("machine"):
        parts.append(f"machine {machine}")
    if stored.get("n"):
        count = stored.get("combinations", 1)
        each = f" for each of {count} combinations of factors" if count > 1 else ""
        parts.append(f"n = {stored['n']} {stored['repeats']}{each}")
    if "seed" in stored:
        parts.append(f"seed {stored['seed']}")
    if missing := [key for key in ("command", "commit", "machine", "n") if not stored.get(key)]:
        parts.append(f"not recorded: {', '.join(missing)}")
    return f"Source: {'; '.join(parts)}."


def block(head: str, old: str) -> str:
    """Return the text of a block from its opening words and its old text."""
    words = head.split()
    names = [word for word in words if "=" not in word] or ["(no name)"]
    options = dict(word.split("=", 1) for word in words if "=" in word)
    files = [read_stored(name) for name in names]
    headings, rows = [], []
    for stored in files:
        headings, more = table_of(stored, options.get("table", "1"))
        rows += more
    if "rows" in options:
        rows = _selected("rows", rows, options["rows"])
    if "columns" in options:
        headings, *rows = (
            _selected("columns", row, options["columns"]) for row in [headings, *rows]
        )
    first = old.strip().split("\n", maxsplit=1)[0]
    if first.startswith("|"):
        kept = [cell.strip() for cell in first.strip("|").split("|")]
        if len(kept) != len(headings):
            raise InputError(f"heading row of {head}", first, f"must have {len(headings)} columns",
                             "Correct it, or delete it for the headings of the study.")  # fmt: skip
        headings = kept
    lines = [headings, ["---"] * len(headings), *rows]
    table = "\n".join(f"| {' | '.join(row)} |" for row in lines)
    return f"\n{table}\n\n{' '.join(dict.fromkeys(map(source_line, files)))}\n\n"


def _selected(field: str, items: list[Any], numbers: str) -> list[Any]:
    """Return the items with the given numbers, from 1, separated by commas."""
    try:
        return [items[range(1, len(items) + 1).index(int(number))] for number in numbers.split(",")]
    except ValueError:
        problem = f"must be numbers from 1 to {len(items)}, separated by commas"
        raise InputError(field, numbers, problem, _REMEDY) from None


def update_page(text: str) -> str:
    """Return the text of a page with current blocks."""
    if len(BLOCK.findall(text)) != text.count(OPENING):
        raise InputError(
            "blocks", text.count(OPENING), f"must each end with {END}", "Add the line."
        )
    return BLOCK.sub(lambda m: f"{OPENING}{m[1]} -->\n{block(m[1], m[2])}{END}", text)


def pages() -> dict[Path, str]:
    """Return the current text of each page that differs from the stored results."""
    found = {}
    for path in sorted(DOCS.rglob("*.md")):
        old = path.read_text(encoding="utf-8")
        try:
            new = update_page(old)
        except InputError as error:
            name = path.relative_to(DOCS.parent)
            raise error.with_field(f"{name}: {error.field}") from None
        if new != old:
            found[path] = new
    return found


def read_stored(name: str) -> Data:
    """Return a stored file by its name in docs/results, without suffix."""
    return _read(STORED / f"{name}.json")


def _read(path: Path) -> Data:
    """Return the data of a JSON file of a study."""
    try:
        found: Data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError("file", str(path), f"must be a JSON file ({error_reason(error)})",
                         "Store the results with --store.") from None  # fmt: skip
    return found


class TableRecorder(Console):
    """Console that keeps the tables of a report and prints nothing."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.tables: list[Data] = []

    def print(self, *objects: Any, **style: Any) -> None:
        """Keep title, headings and cells of the tables among the objects."""
        for table in (one for one in objects if isinstance(one, Table)):
            heads = [" ".join(str(column.header).split()) for column in table.columns]
            rows = zip(*(map(str, column.cells) for column in table.columns), strict=True)
            kept = {"title": str(table.title or ""), "columns": heads, "rows": list(rows)}
            self.tables.append(kept)


def stored_parts(name: str, path: Path) -> dict[str, Data]:
    """Return what is stored of a file results.json, by name in docs/results."""
    results = _read(path)
    if not {"study", "options", "rows"} <= results.keys() or not results.get("complete"):
        raise InputError("FILE", str(path), "must be the complete results.json of a study",
                         "Repeat the command of the study.")  # fmt: skip
    study, options = load_study(results["study"]), results["options"]
    words = shlex.split(results.get("command", ""))
    if words and words[0].endswith(".py"):
        words[:1] = ["python", f"scenarios/{results['study']}.py"]
    machine = results.get("machine", {})
    parts = (machine.get("platform"), machine.get("processor"), f"{machine.get('cores')} cores")
    origin = {
        "study": results["study"], "command": shlex.join(words), "commit": results.get("commit"),
        "script": results.get("script"), "date": results.get("date"),
        "machine": ", ".join(map(str, parts)) if machine else None,
        "n": options[study.repeats], "repeats": study.repeats,
        "combinations": prod(len(levels) for levels in options["levels"].values()),
    }  # fmt: skip
    origin = {key: value for key, value in origin.items() if value} | {"seed": options["seed"]}
    if name.startswith("by_seed/"):
        return {name: origin | {"metrics": list(METRICS[results["study"]](results["rows"]))}}
    if name == "lidar_maps":
        worlds = _read(path.with_name("figures.json"))
        slugs = {world: re.sub(r"[^a-z0-9]+", "_", world.lower()).strip("_") for world in worlds}
        return {f"{name}/{slugs[world]}": origin | {"world": world, "figures": finite(figures)}
                for world, figures in worlds.items()}  # fmt: skip
    console = TableRecorder()
    report_study(study, results["rows"], seed=options["seed"], options=options, console=console)
    return {name: origin | {"tables": console.tables}}


def finite(data: Any) -> Any:
    """Replace non-finite numbers in nested data by None, for JSON."""
    if isinstance(data, dict):
        return {key: finite(value) for key, value in data.items()}
    if isinstance(data, list):
        return [finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


@click.command()
@click.option("--check", is_flag=True, help="Change nothing; exit with code 1 if a page differs.")
@click.option("--store", type=(str, click.Path(path_type=Path)), default=None,
              help="Name in docs/results and file results.json of a study, to store before the "
              "pages are updated.")  # fmt: skip
def main(check: bool, store: tuple[str, Path] | None) -> None:
    """Update the blocks of results in the pages of docs."""
    try:
        for name, data in stored_parts(*store).items() if store else ():
            path = STORED / f"{name}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        changed = pages()
    except InputError as error:
        raise click.UsageError(str(error)) from None
    for path, text in changed.items():
        print(path.relative_to(DOCS.parent))
        if not check:
            path.write_text(text, encoding="utf-8")
    if check and changed:
        sys.exit(1)


if __name__ == "__main__":
    main()
