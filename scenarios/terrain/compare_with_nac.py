"""Compare rendered images with a real LROC narrow-angle camera image of boulders.

Terrains of the shipped scenarios are rendered with the pixels, point spread and Sun of the real
image: once with the plain light (point Sun, lunar-Lambert) and once with all effects of `[sun]`. No
parameter is fitted to the image except the mean albedo, by which both images are divided. The
comparison covers histogram, power spectrum, autocorrelation and shadow lengths.

python scenarios/terrain/compare_with_nac.py --out out/nac
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim import RandomStreams, Scenario, build_world, flight_seed
from lunarsim.api import State
from lunarsim.sensors.camera import Camera
from lunarsim.studies import (
    Case,
    Metric,
    Report,
    Study,
    metric_table,
    pack_array,
    run_script,
    unpack_array,
)
from lunarsim.viz.style import COLOURS, new_figure, save
from lunarsim.world import World
from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO, SUN_DIAMETER_RAD, Light

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
REAL = ROOT / "data" / "moon_nac_M143947267L_iof_400.npz"
SAMPLE, LINE, SIDE = 0.545, 0.58, 400
ALTITUDE = 3000.0
# Sun elevation 36.56 deg; shadows point along (0.82, -0.57) in samples and lines: east and north.
SHADOWS = np.array([0.82 * SAMPLE, 0.57 * LINE])
ELEVATION = np.radians(36.56)
AZIMUTH = float(np.arctan2(-SHADOWS[0], -SHADOWS[1]))
# High-pass scale, pixels, 1 sigma: larger structures belong to the region, not the terrain, and are
# divided out of the real and the rendered images.
REGION = 40.0
# Pixels below this value, relative to the local mean, count as shadow.
DARK = 0.55


def make_light(full_effects: bool, seed: int) -> Light:
    """Return the light of the real image: a point Sun, or all light effects.

    `full_effects` enables the effects; `seed` is that of the albedo variation.
    """
    plain = Light(AZIMUTH, ELEVATION)
    if not full_effects:
        return plain
    return replace(
        plain, photometry="hapke", diameter=SUN_DIAMETER_RAD, scattered_light=True,
        earthshine=0.5 * FULL_EARTH_IRRADIANCE_RATIO, albedo_variation=0.05, boulder_albedo=1.3,
        boulder_albedo_variation=0.15,
        albedo_seed=seed,
    )  # fmt: skip


def make_camera() -> Camera:
    """Return a camera with the pixels of the real image, 12 bits up to an I/F of 0.3.

    I/F is the radiance factor: radiance relative to a white diffuse surface under the Sun overhead.
    """
    return Camera(
        SIDE, SIDE, ALTITUDE / SAMPLE, ALTITUDE / LINE, exposure=1e-3,
        mount=np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
        sensitivity=2e8, full_well=60_000.0, bits=12, read_noise=70.0,
    )  # fmt: skip


def render(scenario_name: str, full_effects: bool, seed: int) -> Array:
    """Render I/F (400, 400) of a scenario's terrain as seen by the real camera.

    `full_effects` enables all light effects.
    """
    scenario = Scenario.load(ROOT / f"{scenario_name}.toml")
    if hasattr(scenario.terrain, "size_m"):
        scenario = scenario.changed(terrain={"size_m": 260.0})
    world = build_world(scenario, RandomStreams(flight_seed(seed, 0)))
    world = World(world.terrain, world.gravity, make_light(full_effects, seed))
    x, y = scenario.target.position_m
    height = float(world.terrain.elevation([x, y])) + ALTITUDE
    state = State(
        np.array([x, y, height]), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1.0
    )
    nac = make_camera()
    counts = nac.expose(world, state, 0.0, np.random.default_rng(seed)).counts
    return counts / (2**nac.bits - 1) * nac.full_well / (nac.sensitivity * nac.exposure)


def divide_by_local_mean(image: Array) -> Array:
    """Divide an image by its Gaussian local mean to remove large-scale brightness."""
    return np.asarray(image / ndimage.gaussian_filter(image, REGION, mode="reflect"))


def spectrum(normalised: Array) -> tuple[Array, Array]:
    """Return the power spectrum of a normalised image, averaged over rings.

    Returns wave numbers (cycles/m), which grow by a constant ratio, and power (m^2).
    """
    window = np.outer(np.hanning(SIDE), np.hanning(SIDE))
    window /= np.sqrt(np.mean(window**2))
    power = (
        np.abs(np.fft.fft2((normalised - normalised.mean()) * window)) ** 2
        * SAMPLE
        * LINE
        / SIDE**2
    )
    k = np.hypot(np.fft.fftfreq(SIDE, SAMPLE)[None, :], np.fft.fftfreq(SIDE, LINE)[:, None])
    edges = np.geomspace(0.02, 0.85, 14)
    ring = np.digitize(k.ravel(), edges)
    mean = [power.ravel()[ring == n].mean() for n in range(1, edges.size)]
    return np.sqrt(edges[1:] * edges[:-1]), np.array(mean)


def correlation(normalised: Array) -> tuple[Array, Array]:
    """Return the autocorrelation of a normalised image along and across the shadows.

    Returns distances (n,), m, and the two correlations (2, n).
    """
    f = np.fft.fft2(normalised - normalised.mean())
    auto = np.fft.ifft2(np.abs(f) ** 2).real
    auto = np.fft.fftshift(auto / auto[0, 0])
    distance = np.arange(0.0, 15.0, 0.5)
    along = SHADOWS / np.hypot(*SHADOWS)
    out = []
    for east, north in (along, (-along[1], along[0])):
        rows = SIDE // 2 - distance * north / LINE
        columns = SIDE // 2 + distance * east / SAMPLE
        out.append(ndimage.map_coordinates(auto, [rows, columns], order=1))
    return distance, np.array(out)


def shadow_lengths(normalised: Array) -> Array:
    """Return the length of each dark patch along the shadow direction (n,), m.

    `normalised` is an image divided by its local mean; patches of one pixel are omitted.
    """
    patches, count = ndimage.label(normalised < DARK, np.ones((3, 3)))
    along = SHADOWS / np.hypot(*SHADOWS)
    lengths = []
    for at in ndimage.find_objects(patches)[:count]:
        rows, columns = np.nonzero(patches[at] == patches[at].max())
        if rows.size >= 2:
            reach = columns * SAMPLE * along[0] - rows * LINE * along[1]
            lengths.append(float(np.ptp(reach)) + 0.56)
    return np.array(lengths)


def image_metrics(image: Array, real: Array) -> dict[str, Any]:
    """Return histogram, spectrum, correlation and shadow metrics of an image.

    The histogram distance is that from the `real` image.
    """
    flat = divide_by_local_mean(image)
    k, power = spectrum(flat)
    distance, auto = correlation(flat)
    lengths = shadow_lengths(flat)
    fine = (k > 0.05) & (k < 0.6)
    slope = np.polyfit(np.log(k[fine]), np.log(power[fine]), 1)[0]
    half = [float(distance[np.argmax(a < 0.5)]) for a in auto]
    return {
        "mean": float(image.mean()), "spread": float(flat.std()),
        "skewness": float(np.mean((flat - flat.mean()) ** 3) / flat.std() ** 3),
        "histogram_distance": histogram_distance(flat, divide_by_local_mean(real)),
        "percentiles": np.percentile(flat, [1, 5, 25, 75, 95, 99]).round(4).tolist(),
        "slope": float(slope), "half_along_m": half[0], "half_across_m": half[1],
        "shadow_share": float(np.mean(flat < DARK)),
        "shadows_ha": float(lengths.size / (SIDE**2 * SAMPLE * LINE) * 1e4),
        "length_median_m": float(np.median(lengths)) if lengths.size else 0.0,
        "length_90_m": float(np.percentile(lengths, 90)) if lengths.size else 0.0,
        "wave_numbers": k.tolist(), "power": power.tolist(),
    }  # fmt: skip


def histogram_distance(first: Array, second: Array) -> float:
    """Return the mean absolute difference of the sorted pixel values of two images.

    Each image is divided by its local mean.
    """
    return float(np.mean(np.abs(np.sort(first.ravel()) - np.sort(second.ravel()))))


def smooth_area_statistics(image: Array) -> tuple[float, float]:
    """Return relative brightness spread and correlation length (m) of a smooth area.

    `image` is the real image. The correlation length is at 1/e. The spread is an upper limit of the
    albedo variation, because it includes unresolved relief.
    """
    part = divide_by_local_mean(image)[60:380, 260:390]
    part = part - part.mean()
    rows = [np.mean(part[: part.shape[0] - k] * part[k:]) for k in range(24)]
    columns = [np.mean(part[:, : part.shape[1] - k] * part[:, k:]) for k in range(24)]
    lengths = [
        side * float(np.interp(-np.exp(-1.0), -np.array(auto) / auto[0], np.arange(24)))
        for side, auto in ((LINE, rows), (SAMPLE, columns))
    ]
    return float(part.std()), float(np.mean(lengths))


def compare(case: Case) -> list[dict[str, Any]]:
    """Render terrains with a point Sun and with all light effects; compute metrics.

    One row per image; the real image is the first. `pixels` holds the image as compressed text.
    """
    with np.load(REAL) as data:
        images = {"real": data["iof"].astype(np.float64)}
    for name in case["terrain"]:
        for light in ("plain", "full"):
            images[f"{name}, {light}"] = render(name, light == "full", case.seed + case.number)
    return [
        {"image": name, **image_metrics(image, images["real"]), "pixels": pack_array(image)}
        for name, image in images.items()
    ]


def print_metrics(report: Report) -> None:
    """Print the metrics of all images; plot those of the first seed."""
    by_image = replace(report, factors=("image",))
    report.print(metric_table(by_image, "Rendered images compared with M143947267L"))
    spread, length = smooth_area_statistics(unpack_array(report.rows[0]["pixels"]))
    report.print(
        f"Smooth terrain of the real image: spread {spread:.3f}, correlation 1/e at {length:.1f} m"
    )
    if report.out is not None:
        draw([row for row in report.rows if row["number"] == 0], report.out / "beside_nac.png")


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Plot the images with their histograms, power spectra and autocorrelations."""
    figure = new_figure(3.1 * len(rows), 6.6)
    axes = figure.subplots(2, max(len(rows), 3), gridspec_kw={"height_ratios": [1.15, 1.0]})
    for ax in axes.ravel():
        ax.axis("off")
    histogram, power, auto = axes[1, :3]
    for ax in (histogram, power, auto):
        ax.axis("on")
    for n, row in enumerate(rows):
        flat = divide_by_local_mean(unpack_array(row["pixels"]))
        axes[0, n].imshow(flat, cmap="gray", vmin=0.2, vmax=1.6, interpolation="nearest")
        axes[0, n].set_title(row["image"])
        colour = "black" if n == 0 else COLOURS[n % len(COLOURS)]
        line: dict[str, Any] = {"color": colour, "linewidth": 2.0 if n == 0 else 1.0}
        bins = np.linspace(0.0, 2.0, 80)
        histogram.hist(
            flat.ravel(), bins, histtype="step", density=True, label=row["image"], **line
        )
        power.loglog(row["wave_numbers"], row["power"], **line)
        distance, both = correlation(flat)
        auto.plot(distance, both[0], **line)
        auto.plot(distance, both[1], "--", **line)
    histogram.set_yscale("log")
    histogram.set_xlabel("I/F / local mean")
    histogram.legend(fontsize=7)
    power.set_xlabel("Wave number (cycles/m)")
    power.set_title("power (m²)")
    power.xaxis.set_minor_formatter(NullFormatter())
    auto.set_xlabel("Distance along the Sun (m); dashed: across")
    auto.set_title("autocorrelation")
    save(figure, path)


METRICS = (
    ("mean", "mean\nI/F", 3), ("spread", "spread /\nlocal mean", 3), ("skewness", "skewness", 2),
    ("histogram_distance", "histogram\ndistance", 3), ("slope", "spectral\nslope", 2),
    ("half_along_m", "correlation 0.5\nalong (m)", 1),
    ("half_across_m", "correlation 0.5\nacross (m)", 1), ("shadow_share", "shadow\nfraction", 4),
    ("shadows_ha", "shadows\nper hectare", 0), ("length_median_m", "shadow length,\nmedian (m)", 2),
    ("length_90_m", "shadow length,\n90th pct. (m)", 2),
)  # fmt: skip

study = Study(
    compare,
    repeats="seeds",
    count=1,
    options=(
        click.Option(
            ["--terrain"], multiple=True, default=("highland", "mare"), show_default=True,
            help="Scenario whose terrain is rendered; repeat the option for several scenarios.",
        ),
    ),
    metrics={name: Metric(label, "median", digits) for name, label, digits in METRICS},
    report=print_metrics,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
