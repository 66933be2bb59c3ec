"""The shadow detector on a real image: boulders seen by LROC's narrow-angle camera.

The detector runs with the settings that rendered images use. Its finds are drawn over the image,
the direction of the shadows is measured and set beside the stated one, and finds in a window of
100 x 100 pixels are compared with boulders told by eye.

python scenarios/shadows/real_image.py --out out/nac
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.patches import Circle, Rectangle
from rich.table import Table
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion
from lunarsim.onboard.perception.detector import Detections, detect_rocks
from lunarsim.onboard.perception.direction import mean_direction, shadow_directions
from lunarsim.sensors.camera import Camera
from lunarsim.vehicle import State
from lunarsim.viz.style import COLOURS, new_figure, save

DATA = Path(__file__).parents[1] / "data"
NAME = "moon_nac_M143947267L"
ALTITUDE = 54_470.0
SAMPLE, LINE = 0.545, 0.58
SUN_ELEVATION = np.radians(90.0 - 53.44)
# Stated: shadows point along (+0.82, -0.57) in samples and lines.
STATED = np.array([0.82, -0.57])
# Farthest that a find may lie from a label, pixels.
NEAR = 2.5
SIZES = ((1, 1), (2, 2), (3, 3), (4, 9))


def load() -> np.ndarray:
    """Return the radiance factor (400, 400)."""
    with np.load(DATA / f"{NAME}_iof_400.npz") as data:
        return data["iof"]


def detect(image: np.ndarray) -> Detections:
    """Run the detector with its default settings.

    The image is mirrored and its north is not needed: "east" is along samples here, "north"
    against lines.
    """
    height, width = image.shape
    down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    camera = Camera(width, height, ALTITUDE / SAMPLE, ALTITUDE / LINE, mount=down)
    state = State(
        np.array([0.0, 0.0, ALTITUDE]),
        np.zeros(3),
        np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3),
        1.0,
    )
    away = STATED * [SAMPLE, -LINE]
    away = away / np.hypot(*away)
    sun = np.array([*(-np.cos(SUN_ELEVATION) * away), np.sin(SUN_ELEVATION)])
    return detect_rocks(image, camera, state, sun)


def middles(seen: Detections) -> np.ndarray:
    """Return the middles of the rocks' shadows (n, 2), column and row."""
    return np.array(
        [np.argwhere(seen.labels == label).mean(0)[::-1] for label in seen.label]
    ).reshape(-1, 2)


def compare(seen: Detections, labels: dict[str, Any]) -> dict[str, Any]:
    """Match finds in the window with labels, each at most once."""
    window = labels["window"]
    low = np.array([window["column"], window["row"]])
    high = low + np.array([window["columns"], window["rows"]])
    found = middles(seen)
    inside = ((found >= low) & (found < high)).all(1)
    found, size = found[inside], seen.q[inside]
    told = np.array(labels["shadows"])
    distance = cdist(found, told[:, :2])
    # A large shadow may be found a little off.
    gate = np.maximum(NEAR, 0.6 * np.maximum(size[:, None], told[None, :, 2]))
    i, j = linear_sum_assignment(np.where(distance <= gate, distance, 1e3))
    good = distance[i, j] <= gate[i, j]
    hit = np.zeros(len(told), bool)
    hit[j[good]] = True
    return {
        "finds": len(found), "true": int(good.sum()), "labels": len(told),
        "width": told[:, 2].astype(int), "hit": hit, "told": told, "found": found,
        "matched": np.isin(np.arange(len(found)), i[good]),
    }  # fmt: skip


def draw(image: np.ndarray, seen: Detections, result: dict[str, Any], window: dict[str, int],
         path: Path) -> None:  # fmt: skip
    """Draw the finds over the image, and the window with the labels."""
    figure = new_figure(11.0, 5.6)
    whole, part = figure.subplots(1, 2)
    low, high = np.percentile(image, [0.5, 99.5])
    for ax in (whole, part):
        ax.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
        ax.set_xlabel("sample (0.545 m)")
        ax.set_ylabel("line (0.58 m)")
        for (u, v), r in zip(seen.pixel, seen.radius, strict=True):
            ax.add_patch(Circle((u, v), r / SAMPLE, fill=False, color=COLOURS[4], linewidth=1.0))
    ends = (window["columns"], window["rows"])
    corner = (window["column"] - 0.5, window["row"] - 0.5)
    whole.add_patch(Rectangle(corner, *ends, fill=False, color=COLOURS[5]))
    whole.annotate("", xy=(80, 345), xytext=(80 - 45 * 0.82, 345 + 45 * 0.57),
                   arrowprops={"arrowstyle": "->", "color": COLOURS[4]})  # fmt: skip
    whole.text(86, 352, "shadows, stated", color=COLOURS[4])
    whole.set_title(f"{len(seen)} rocks found in {NAME}")
    top, left = window["row"], window["column"]
    dark, bright = np.percentile(image[top : top + ends[1], left : left + ends[0]], [0.5, 97])
    part.images[0].set_clim(dark, bright)
    told, hit = result["told"], result["hit"]
    part.plot(told[hit, 0], told[hit, 1], "+", color=COLOURS[2], label="told by eye, found")
    part.plot(told[~hit, 0], told[~hit, 1], "x", color=COLOURS[1], label="told by eye, missed")
    false = result["found"][~result["matched"]]
    part.plot(false[:, 0], false[:, 1], "s", fillstyle="none", color=COLOURS[3], label="false")
    part.set_xlim(corner[0], corner[0] + ends[0])
    part.set_ylim(corner[1] + ends[1], corner[1])
    part.set_title("window; circles: rocks as estimated")
    part.legend(loc="lower left")
    save(figure, path)


@click.command()
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write the figures to this file.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the picture; left out, none is drawn.")  # fmt: skip
def main(json_file: Path | None, out: Path | None) -> None:
    """Detect, measure the shadows' direction, compare with the labels."""
    console = plain_console(100)
    image = load()
    seen = detect(image)
    angle, half, number = mean_direction(shadow_directions(image, seen))
    stated = np.arctan2(STATED[1], STATED[0])
    console.print(
        f"{len(seen)} rocks, {len(seen.extended)} extended shadows; shadows point along "
        f"({np.cos(angle):+.2f} sample, {np.sin(angle):+.2f} line), {np.degrees(angle):.1f} "
        f"± {np.degrees(half):.1f} deg from {number} rocks; stated (+0.82, -0.57), "
        f"{np.degrees(stated):.1f} deg"
    )
    labels = json.loads((DATA / f"{NAME}_labels.json").read_text(encoding="utf-8"))
    result = compare(seen, labels)
    precision = Proportion(result["true"], result["finds"])
    recall = Proportion(result["true"], result["labels"])
    console.print(
        f"window: {precision.total} found, {precision.count} of them boulders: precision "
        f"{precision.value:.2f}; {recall.total} told by eye, recall {recall.value:.2f}"
    )
    table = Table(title="by width of the shadow, pixels")
    for heading in ("width", "told by eye", "found", "recall"):
        table.add_column(heading, justify="right")
    sizes = []
    for low, high in SIZES:
        those = (result["width"] >= low) & (result["width"] <= high)
        found = Proportion(int(result["hit"][those].sum()), int(those.sum()))
        sizes.append({"from": low, "to": high, "told": found.total, "found": found.count})
        name = str(low) if low == high else f"{low} or more"
        table.add_row(name, str(found.total), str(found.count), f"{found.value:.2f}")
    console.print(table)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        figures = {
            "rocks": len(seen), "direction_deg": np.degrees(angle),
            "stated_deg": np.degrees(stated),
            "precision": precision.value, "recall": recall.value, "by_width": sizes,
        }  # fmt: skip
        json_file.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    if out is not None:
        draw(image, seen, result, labels["window"], out / "nac.png")


if __name__ == "__main__":
    main()
