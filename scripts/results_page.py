"""The page of results by seed: `python scripts/results_page.py > docs/results-by-seed.md`.

A study writes its figures with `--json`; `python scripts/results_page.py --take NAME FILE` keeps of
them, in `docs/results/NAME.json`, what the page shows: every figure seed by seed, the paper's
beside it, and the command that gave it (`--command`). The page is made of these files alone.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click

KEPT = Path(__file__).parents[1] / "docs" / "results"

HEAD = """# Results by seed

Made by `python scripts/results_page.py > docs/results-by-seed.md` from the files in `docs/results`,
which studies wrote: each figure with its spread over seeds, and the paper's where it has one. These
are small runs, made to be repeated; the pages of the parts have larger ones.
"""


@dataclass(frozen=True)
class Figure:
    """One figure of a report.

    Attributes
    ----------
    label, unit
        What it is.
    values
        By seed (field, terrain or flight); what a seed did not give is left out.
    paper
        The paper's figure, if it has one.
    better
        ``"higher"``, ``"lower"`` or ``""`` where neither is.
    """

    label: str
    unit: str
    values: list[float]
    paper: float | None = None
    better: str = ""

    @property
    def mean(self) -> float:
        """Mean over seeds."""
        return statistics.fmean(self.values)

    @property
    def falls_short(self) -> bool:
        """Whether its mean is on the wrong side of the paper's figure."""
        if self.paper is None or not self.better:
            return False
        return self.mean < self.paper if self.better == "higher" else self.mean > self.paper


@dataclass(frozen=True)
class Report:
    """What is kept of a study."""

    title: str
    command: str
    page: str
    figures: list[Figure]


def _finite(values: Sequence[float | None]) -> list[float]:
    return [float(v) for v in values if v is not None and math.isfinite(v)]


def gaussian_dem(found: dict[str, Any]) -> list[Figure]:
    """Return Table 3 by complexity, and the calls of Table 6 at a probability of one half."""
    out = []
    for row in found["3"]["rows"]:
        at = f"Table 3, c = {row['c']:g}: "
        out += [
            Figure(f"{at}precision", "", row["precision"], 1.0, "higher"),
            Figure(f"{at}recall", "", row["recall"], row["paper"], "higher"),
            Figure(f"{at}recall of `bounded_safety`", "", row["bounded"]),
        ]
    for name in ("proposed slope", "proposed roughness"):
        configurations = found["6"]["at_half"][name]
        for k, word in enumerate(("precision", "recall")):
            seeds = zip(*([pair[k] for pair in one] for one in configurations), strict=True)
            worst = [min(_finite(values)) for values in seeds]
            out.append(Figure(f"Table 6, {name}, least {word} of nine scans", "", worst))
    return out


def quadtree(found: dict[str, Any]) -> list[Figure]:
    """Return the sweep of the hazard field at its last look."""
    flights = found["flights"]
    looks = [flight["looks"][-1] for flight in flights]
    share = [look["missed_m2"] / max(look["hazard_m2"], 1e-9) for look in looks]
    safe = [sum(s["exactly_safe"] for s in look["sites"]) for look in looks]
    hazard = [sum(s["hazard_m2"] > 0.0 for s in look["sites"]) for look in looks]
    return [
        Figure("time of the lock", "s", _finite([flight["lock"] for flight in flights])),
        Figure(
            "map error, root mean square", "m", [x["map_error_rms"] for x in looks], 0.5, "lower"
        ),
        Figure("slope error, greatest", "deg", [x["slope_error_max"] for x in looks], 6.0, "lower"),
        Figure("share of the hazards' area missed", "", share),
        Figure("safe ground called hazardous", "m2", [x["false_m2"] for x in looks]),
        Figure("sites ranked", "", [float(len(x["sites"])) for x in looks]),
        Figure("of them exactly safe", "", [float(n) for n in safe]),
        Figure("landing zones with a true hazard", "", [float(n) for n in hazard], 0.0, "lower"),
    ]


# Of the map at 50 m: what it is called, the paper's for either path, which side is better.
_RATES = {
    "clear_recall": ("clear ground called clear", (0.11, 0.29), "higher"),
    "clear_false": ("of the ground called clear, hazard", (0.0, 0.0), "lower"),
    "occupied_correct": ("of the ground called occupied, hazard", (0.85, 0.85), "higher"),
}


def shadows(found: dict[str, Any]) -> list[Figure]:
    """Return the maps at 50 m of both descents, and what the lofted one costs."""
    out = []
    flown: dict[str, list[dict[str, Any]]] = {"nominal": [], "modified": []}
    for flight in found["flights"]:
        flown[flight["path"]].append(flight)
    for rate, (label, papers, better) in _RATES.items():
        for (path, flights), paper in zip(flown.items(), papers, strict=True):
            values = _finite([f["levels"]["50.0"]["rates"][rate] for f in flights])
            out.append(Figure(f"{label}, {path}", "", values, paper, better))
    for name, unit, paper in (("propellant", "kg", 1.0), ("duration", "s", 2.0)):
        for path, flights in flown.items():
            out.append(Figure(f"{name}, {path}", unit, [f[name] for f in flights]))
        pairs = zip(flown["nominal"], flown["modified"], strict=True)
        more = [b[name] - a[name] for a, b in pairs]
        out.append(Figure(f"{name}, modified less nominal", unit, more, paper, "lower"))
    return out


def real_returns(found: dict[str, Any]) -> list[Figure]:
    """Return errors at the returns held back, of the map that flights draw and of the paper's."""
    out = []
    for name in ("as flights do", "field of Table 6"):
        splits = found["ground"]["heights"][name]["by split"]
        out += [
            Figure(f"{name}: {label}", unit, [split[key] for split in splits])
            for key, label, unit in (
                ("rmse", "RMSE", "m"),
                ("nees", "mean square of error over stated sigma (1)", ""),
                ("beyond2", "share beyond 2 sigma (0.046)", ""),
            )
        ]
    return out


STUDIES: dict[str, tuple[str, str, Callable[[dict[str, Any]], list[Figure]]]] = {
    "gaussian_dem": ("Gaussian DEM", "gaussian-dem", gaussian_dem),
    "quadtree": ("Quadtree on the hazard field", "quadtree", quadtree),
    "shadows": ("Rocks by their shadows, two descents", "shadow-filter", shadows),
    "real_returns": ("Real returns", "real-returns", real_returns),
}


def take(name: str, found: dict[str, Any], command: str) -> Report:
    """Return what is kept of what a study wrote."""
    title, page, figures = STUDIES[name]
    return Report(title, command, page, figures(found))


def load(path: Path) -> Report:
    """Return a report as it was kept."""
    kept = json.loads(path.read_text(encoding="utf-8"))
    return Report(**kept | {"figures": [Figure(**f) for f in kept["figures"]]})


def section(report: Report) -> str:
    """Return a report as Markdown."""
    out = [f"## {report.title}\n", f"`{report.command}`; [more]({report.page}.md).\n"]
    out += [
        "| figure | mean | least to greatest | seeds | paper |",
        "| --- | --- | --- | --- | --- |",
    ]
    for f in report.figures:
        unit = f" ({f.unit})" if f.unit else ""
        paper = "" if f.paper is None else f"{f.paper:.4g}"
        out.append(
            f"| {f.label}{unit} | {f.mean:.4g} | {min(f.values):.4g} to {max(f.values):.4g} "
            f"| {len(f.values)} | {paper} |"
        )
    short = [f"{f.label} ({f.mean:.4g} for {f.paper:.4g})" for f in report.figures if f.falls_short]
    told = any(f.paper is not None for f in report.figures)
    said = "; ".join(short) if short else "nothing here" if told else "no paper has these figures"
    return "\n".join([*out, f"\nShort of the paper: {said}.\n"])


def page() -> str:
    """Return the page as Markdown."""
    return "\n".join([HEAD, *(section(load(path)) for path in sorted(KEPT.glob("*.json")))])


@click.command()
@click.option("--take", "taken", type=(click.Choice(list(STUDIES)), click.Path(path_type=Path)),
              help="A study, and the file that it wrote.")  # fmt: skip
@click.option("--command", default="", help="That wrote it.")
def main(taken: tuple[str, Path] | None, command: str) -> None:
    """Print the page, or keep what a study wrote."""
    if taken is None:
        print(page(), end="")
        return
    name, path = taken
    report = take(name, json.loads(path.read_text(encoding="utf-8")), command)
    KEPT.mkdir(exist_ok=True)
    text = json.dumps(asdict(report), indent=1) + "\n"
    (KEPT / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
