"""Draw the reference frames: `frames_figure.py docs/images/frames.png`."""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

_COLORS = {"x": "tab:red", "z": "tab:blue"}


def main() -> None:
    """Write the figure to the path in the first argument."""
    figure, ax = plt.subplots(figsize=(9.0, 5.0), layout="constrained")
    east = np.linspace(-80.0, 640.0, 400)
    ax.fill_between(east, 6.0 * np.sin(east / 35.0), -75.0, color="0.85")
    ax.plot(east, 6.0 * np.sin(east / 35.0), color="0.5")
    _axes(ax, (0.0, 0.0), 0.0, 75.0, ("east", "up"))
    ax.text(20.0, -42.0, "true and site frame:\ncentre of the terrain", ha="center", va="center")
    _axes(ax, (40.0, 55.0), 0.0, 55.0, ("east", "up"), style="--")
    ax.text(105.0, 100.0, "local frame (onboard): offset from\nthe site frame by the error of\n"
            "the initial estimate", va="bottom")  # fmt: skip
    lander, tilt = (430.0, 300.0), np.deg2rad(20.0)
    body = np.array([(-18, -10), (18, -10), (12, 14), (-12, 14), (-18, -10)], dtype=float)
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    for leg in (((-18, -10), (-34, -38)), ((18, -10), (34, -38))):
        ax.plot(*(np.array(leg) @ turn.T + lander).T, color="0.25", lw=2)
    ax.fill(*(body @ turn.T + lander).T, color="0.45")
    _axes(ax, lander, tilt, 85.0, ("x body (forward)", "z body (thrust)"))
    aim = np.array([150.0, 0.0]) - lander
    aim = 120.0 * aim / np.linalg.norm(aim)
    ax.annotate("", np.add(lander, aim), lander,
                arrowprops={"arrowstyle": "->", "color": "tab:green"})  # fmt: skip
    ax.text(lander[0] + aim[0] - 8.0, lander[1] + aim[1], "z sensor (boresight)", color="tab:green",
            ha="right")  # fmt: skip
    ax.annotate("", (600.0, 40.0), (480.0, 40.0), arrowprops={"arrowstyle": "->", "color": "0.4"})
    ax.text(540.0, 48.0, "azimuth 90 deg (east)", color="0.4", ha="center")
    ax.set(xlabel="East (m)", ylabel="Up (m)", xlim=(-80, 640), ylim=(-75, 420), aspect="equal")
    figure.savefig(sys.argv[1], dpi=110)


def _axes(
    ax: Axes, origin: tuple[float, float], tilt: float, length: float, names: tuple[str, str],
    style: str = "-",
) -> None:  # fmt: skip
    """Draw the x and z axes of a frame turned by `tilt` (rad) from east and up."""
    directions = ((np.cos(tilt), np.sin(tilt)), (-np.sin(tilt), np.cos(tilt)))
    for name, axis, direction in zip(names, _COLORS, directions, strict=True):
        tip = np.add(origin, length * np.array(direction))
        arrow = {"arrowstyle": "->", "color": _COLORS[axis], "lw": 1.8, "linestyle": style}
        ax.annotate("", tip, origin, arrowprops=arrow)
        ax.text(*(tip + 6.0), name, color=_COLORS[axis])


if __name__ == "__main__":
    main()
