"""Define the commands `lunarsim view` and `lunarsim film`."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lunarsim.cli_common import PATH, FloatRange, allow_options, progress_bar
from lunarsim.errors import check_output

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lunarsim.simulation import Simulation
    from lunarsim.view.viewer import LiveView

_SAVE = "Use --save FILE.rrd: it needs no display. Open the file on a machine with one."
_RECORD = "Use --out DIR and `lunarsim view DIR --save FILE.rrd`, which need no display."


@click.command()
@click.argument("flight", type=PATH)
@click.option(
    "--save", type=PATH, default=None, metavar="FILE.rrd",
    help="Recording to write. It needs no display. Default: open the viewer.",
)  # fmt: skip
@allow_options
def view(flight: Path, save: Path | None) -> None:
    """Open a recorded flight in the Rerun viewer.

    FLIGHT is a folder from `lunarsim fly SCENARIO --out DIR`. The viewer needs the extra `view`.

    \b
    Example:
      lunarsim fly golombek --policy safest --out out/one
      lunarsim view out/one --save one.rrd
    """  # noqa: D301  (click wants the character itself)
    from lunarsim.simulation.flight import Flight
    from lunarsim.view.viewer import check_viewer, import_rerun, save_recording, view_flight

    if save is None:
        check_viewer("view", _SAVE)
        view_flight(Flight.load(flight))
        return
    import_rerun("view")
    check_output("--save", save, ".rrd")
    path = save_recording(Flight.load(flight), save)
    click.echo(f"{path}: {path.stat().st_size / 1e6:.1f} MB. Open it with `rerun {path}`.")


@click.command()
@click.argument("flight", type=PATH)
@click.option(
    "--out", type=PATH, default=Path("film.mp4"), show_default=True,
    help="Film to write: .mp4, or .gif with half the size and half the frame rate.",
)  # fmt: skip
@click.option(
    "--seconds", type=FloatRange(1.0, 600.0), default=20.0, show_default=True,
    help="Duration of the film. The flight is shown faster or slower to fit.",
)  # fmt: skip
@allow_options
def film(flight: Path, out: Path, seconds: float) -> None:
    """Render a film of a recorded flight: chase view, instruments.

    FLIGHT is a folder from `lunarsim fly SCENARIO --out DIR`. The film shows the true state, and
    the hazard map from the time of its last update on. Rendering needs OpenGL, but no display.

    \b
    Example:
      lunarsim film out/one --out out/one.mp4
    """  # noqa: D301  (click wants the character itself)
    from lunarsim.simulation.flight import Flight
    from lunarsim.view.film import film_suffix, frame_count, save_film

    check_output("--out", out, film_suffix("--out", out))
    loaded = Flight.load(flight)
    with progress_bar("film", frame_count(out, seconds)) as advance:
        save_film(loaded, out, seconds=seconds, progress=advance)
    click.echo(f"{out}: {seconds:g} s, {loaded.duration:.1f} s of flight")


def check_live_view() -> None:
    """Raise InputError if a live view cannot be opened."""
    from lunarsim.view.viewer import check_viewer

    check_viewer("--view", _RECORD)


@contextmanager
def live_view(simulation: Simulation) -> Iterator[LiveView]:
    """Open a viewer that shows a flight while it is simulated, for a `with` statement."""
    from lunarsim.view.viewer import LiveView

    shown = LiveView(
        simulation.world, simulation.lander, simulation.state.position, simulation.briefing.target,
        simulation.recorder.cameras,
    )  # fmt: skip
    try:
        yield shown
    finally:
        shown.close()
