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
which studies wrote: each figure with its spread over seeds, and the paper's, or the optimum's,
where there is one. These are small runs, made to be repeated; the pages of the parts have larger
ones. Those of the LiDAR maps are on [a page](lidar-maps.md) of their own, made in the same way.
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
    """What is kept of a study.

    Attributes
    ----------
    title, command, page
        Its name, what wrote it, and the page that tells more.
    figures
        Seed by seed.
    beside
        What the figures beside them are of, where they have any.
    """

    title: str
    command: str
    page: str
    figures: list[Figure]
    beside: str = "paper"


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


def guidance(found: list[dict[str, Any]]) -> list[Figure]:
    """Return what each law spends to the ground over the optimum, and how it ends."""
    out = []
    for law in dict.fromkeys(row["law"] for row in found):
        mine = [row for row in found if row["law"] == law]
        least = [row["optimum"] + row["descent"] for row in mine]
        over = [100.0 * (row["whole"] / o - 1.0) for row, o in zip(mine, least, strict=True)]
        out += [
            Figure(f"`{law}`: over the optimum, to the ground", "%", over, 0.0, "lower"),
            Figure(f"`{law}`: the approach ends off by", "m/s", [row["speed"] for row in mine]),
            Figure(f"`{law}`: landed safe", "", [float(row["safe"]) for row in mine]),
        ]
    return out


def navigation(found: dict[str, list[dict[str, Any]]]) -> list[Figure]:
    """Return errors over what the filter says of them, and how far off flights ended."""
    (flights,) = found.values()
    out = [
        Figure(f"NEES over degrees of freedom, {part} (1)", "",
               _finite([f["nees"][part] for f in flights]))
        for part in flights[0]["nees"]
    ]  # fmt: skip
    for kind in sorted({kind for f in flights for kind in f["nis"]}):
        values = [f["nis"][kind] for f in flights if kind in f["nis"]]
        out.append(Figure(f"NIS over degrees of freedom, {kind} (1)", "", values))
    for key, label, unit in (
        ("start_error", "error of position at the start", "m"),
        ("map_error", "at touchdown", "m"),
        ("lost", "lost at the end", ""),
        ("safe", "landed safe", ""),
    ):
        out.append(Figure(label, unit, [float(f[key]) for f in flights]))
    return out


STUDIES: dict[str, tuple[str, str, Callable[[Any], list[Figure]]]] = {
    "gaussian_dem": ("Gaussian DEM", "gaussian-dem", gaussian_dem),
    "quadtree": ("Quadtree on the hazard field", "quadtree", quadtree),
    "shadows": ("Rocks by their shadows, two descents", "shadow-filter", shadows),
    "real_returns": ("Real returns", "real-returns", real_returns),
    "guidance": ("Laws of guidance against the optimum", "guidance", guidance),
    "navigation": ("Navigation by the lander's own instruments", "navigation", navigation),
}
# What their figures stand beside, where that is no paper.
_BESIDE = {"guidance": "optimum"}


def take(name: str, found: Any, command: str) -> Report:
    """Return what is kept of what a study wrote."""
    title, page, figures = STUDIES[name]
    return Report(title, command, page, figures(found), _BESIDE.get(name, "paper"))


def load(path: Path) -> Report:
    """Return a report as it was kept."""
    kept = json.loads(path.read_text(encoding="utf-8"))
    return Report(**kept | {"figures": [Figure(**f) for f in kept["figures"]]})


def section(report: Report) -> str:
    """Return a report as Markdown."""
    out = [f"## {report.title}\n", f"`{report.command}`; [more]({report.page}.md).\n"]
    out += [
        f"| figure | mean | least to greatest | seeds | {report.beside} |",
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
    return "\n".join([*out, f"\nShort of the {report.beside}: {said}.\n"])


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
