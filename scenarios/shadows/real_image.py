"""Test the shadow detector on a real LROC narrow-angle camera image with boulders.

The detector uses the settings for rendered images. Its detections are drawn over the image, the
measured shadow direction is compared with the published one, and the detections in a window of
100 x 100 pixels are compared with manually labelled boulders.

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

from lunarsim.api import State
from lunarsim.console import plain_console
from lunarsim.onboard.perception.detector import Detections, detect_rocks
from lunarsim.onboard.perception.shadow_direction import mean_direction, shadow_directions
from lunarsim.sensors.camera import Camera
from lunarsim.studies import Proportion
from lunarsim.viz.style import COLOURS, new_figure, save

DATA = Path(__file__).parents[1] / "data"
NAME = "moon_nac_M143947267L"
ALTITUDE = 54_470.0
SAMPLE, LINE = 0.545, 0.58
SUN_ELEVATION = np.radians(90.0 - 53.44)
# Published: shadows point along (+0.82, -0.57) in samples and lines.
STATED = np.array([0.82, -0.57])
# Maximum distance of a detection from a label, pixels.
MAX_DISTANCE_PX = 2.5
SIZES = ((1, 1), (2, 2), (3, 3), (4, 9))


def load_image() -> np.ndarray:
    """Load the real lunar image as radiance factor I/F (400, 400)."""
    with np.load(DATA / f"{NAME}_iof_400.npz") as data:
        return data["iof"]


def detect_in_image(image: np.ndarray) -> Detections:
    """Detect rocks by their shadows in a real image with the default settings.

    The axes of the result are those of the image: "east" is along samples, "north" against lines.
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


def shadow_centers(detections: Detections) -> np.ndarray:
    """Return the centers of the detected rock shadows (n, 2), column and row."""
    return np.array(
        [np.argwhere(detections.labels == label).mean(0)[::-1] for label in detections.label]
    ).reshape(-1, 2)


def match_labels(detections: Detections, labels: dict[str, Any]) -> dict[str, Any]:
    """Match detections in the labelled window with the labelled shadows one to one.

    `labels` is the content of the label file. Returns numbers of detections, matches and labels,
    and for each label its shadow width (pixels) and whether it was detected.
    """
    window = labels["window"]
    low = np.array([window["column"], window["row"]])
    high = low + np.array([window["columns"], window["rows"]])
    found = shadow_centers(detections)
    inside = ((found >= low) & (found < high)).all(1)
    found, size = found[inside], detections.q[inside]
    labelled = np.array(labels["shadows"])
    distance = cdist(found, labelled[:, :2])
    # The detected center of a large shadow can differ more.
    gate = np.maximum(MAX_DISTANCE_PX, 0.6 * np.maximum(size[:, None], labelled[None, :, 2]))
    i, j = linear_sum_assignment(np.where(distance <= gate, distance, 1e3))
    good = distance[i, j] <= gate[i, j]
    hit = np.zeros(len(labelled), bool)
    hit[j[good]] = True
    return {
        "detections": len(found), "true": int(good.sum()), "labels": len(labelled),
        "width": labelled[:, 2].astype(int), "hit": hit, "labelled": labelled, "found": found,
        "matched": np.isin(np.arange(len(found)), i[good]),
    }  # fmt: skip


def draw(image: np.ndarray, detections: Detections, result: dict[str, Any], window: dict[str, int],
         path: Path) -> None:  # fmt: skip
    """Plot the detections over the image, and the labelled window in detail.

    `result` is the value of `match_labels`; `window` gives first row and column and size, pixels.
    """
    figure = new_figure(11.0, 5.6)
    full, part = figure.subplots(1, 2)
    low, high = np.percentile(image, [0.5, 99.5])
    for ax in (full, part):
        ax.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
        ax.set_xlabel("Sample (0.545 m)")
        ax.set_ylabel("Line (0.58 m)")
        for (u, v), r in zip(detections.pixel, detections.radius, strict=True):
            ax.add_patch(Circle((u, v), r / SAMPLE, fill=False, color=COLOURS[4], linewidth=1.0))
    ends = (window["columns"], window["rows"])
    corner = (window["column"] - 0.5, window["row"] - 0.5)
    full.add_patch(Rectangle(corner, *ends, fill=False, color=COLOURS[5]))
    full.annotate("", xy=(80, 345), xytext=(80 - 45 * 0.82, 345 + 45 * 0.57),
                   arrowprops={"arrowstyle": "->", "color": COLOURS[4]})  # fmt: skip
    full.text(86, 352, "published shadow direction", color=COLOURS[4])
    full.set_title(f"{len(detections)} rocks detected in {NAME}")
    top, left = window["row"], window["column"]
    dark, bright = np.percentile(image[top : top + ends[1], left : left + ends[0]], [0.5, 97])
    part.images[0].set_clim(dark, bright)
    labelled, hit = result["labelled"], result["hit"]
    part.plot(labelled[hit, 0], labelled[hit, 1], "+", color=COLOURS[2], label="labelled, detected")
    part.plot(labelled[~hit, 0], labelled[~hit, 1], "x", color=COLOURS[1], label="labelled, missed")
    false = result["found"][~result["matched"]]
    part.plot(
        false[:, 0], false[:, 1], "s", fillstyle="none", color=COLOURS[3], label="false detection"
    )
    part.set_xlim(corner[0], corner[0] + ends[0])
    part.set_ylim(corner[1] + ends[1], corner[1])
    part.set_title("window; circles: estimated rocks")
    part.legend(loc="lower left")
    save(figure, path)


@click.command()
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for the metrics. Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure. Default: no figure.")  # fmt: skip
def main(json_file: Path | None, out: Path | None) -> None:
    """Detect rocks in a real image; compare shadow direction and rocks with labels."""
    console = plain_console(100)
    image = load_image()
    seen = detect_in_image(image)
    angle, half, number = mean_direction(shadow_directions(image, seen))
    stated = np.arctan2(STATED[1], STATED[0])
    console.print(
        f"{len(seen)} rocks, {len(seen.excluded_labels)} extended shadows; shadow direction "
        f"({np.cos(angle):+.2f} sample, {np.sin(angle):+.2f} line), {np.degrees(angle):.1f} "
        f"± {np.degrees(half):.1f} deg from {number} rocks; published (+0.82, -0.57), "
        f"{np.degrees(stated):.1f} deg"
    )
    labels = json.loads((DATA / f"{NAME}_labels.json").read_text(encoding="utf-8"))
    result = match_labels(seen, labels)
    precision = Proportion(result["true"], result["detections"])
    recall = Proportion(result["true"], result["labels"])
    console.print(
        f"Window: {precision.total} detections, {precision.count} of them boulders: precision "
        f"{precision.value:.2f}; {recall.total} labelled, recall {recall.value:.2f}"
    )
    table = Table(title="Recall by shadow width")
    for heading in ("width (pixels)", "labelled", "detected", "recall"):
        table.add_column(heading, justify="right")
    sizes = []
    for low, high in SIZES:
        those = (result["width"] >= low) & (result["width"] <= high)
        found = Proportion(int(result["hit"][those].sum()), int(those.sum()))
        sizes.append({"from": low, "to": high, "labelled": found.total, "detected": found.count})
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
