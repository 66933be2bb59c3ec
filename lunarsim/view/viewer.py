"""Write recordings to files, and open the Rerun viewer."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, check_output, missing_package
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.scenario.files import parsed_toml
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.typing import Array
from lunarsim.view.blueprint import flight_blueprint
from lunarsim.view.display import has_display
from lunarsim.view.recording import Recording
from lunarsim.world import World

# Maximum time to wait for the viewer after the last data, s.
_FLUSH_TIMEOUT_S = 20.0
_SAVE = "Use --save FILE.rrd, and open the file with `rerun FILE.rrd`."


def check_viewer(field: str, remedy: str) -> None:
    """Raise InputError if the viewer is not installed or has no display.

    `field` is the name of the command or option that needs it, `remedy` the text for a machine
    without a display.
    """
    import_rerun(field)
    if not has_display():
        raise InputError(
            field, None, "needs a display, and this machine has none", remedy, show_value=False
        )


def import_rerun(field: str) -> Any:
    """Return the module `rerun`, which is in an extra.

    If it is missing, raise InputError that names the extra. `field` is the name of the
    command, option or argument that needs it.
    """
    try:
        import rerun  # noqa: PLC0415  (an extra)
    except ImportError:
        raise missing_package(field, "rerun-sdk", "view") from None
    return rerun


def _spawn(stream: Any, blueprint: Any) -> None:
    """Open the viewer, or connect to the one that is open, and send a stream to it.

    The program of the viewer is that of the installed package, which need not be on the path.
    """
    import rerun  # noqa: PLC0415  (an extra)
    import rerun_cli  # type: ignore[import-untyped]  # noqa: PLC0415  (an extra)

    program = Path(str(rerun_cli.__file__)).with_name("rerun")
    try:
        rerun.spawn(
            default_blueprint=blueprint,
            executable_path=str(program) if program.exists() else None,
            recording=stream,
        )
    except RuntimeError as error:
        raise InputError(
            "view", None, f"cannot start the viewer ({str(error).splitlines()[0]})",
            _SAVE, show_value=False,
        ) from None  # fmt: skip


def save_recording(flight: Flight, path: str | Path, world: World | None = None) -> Path:
    """Write a flight as a recording of Rerun (``.rrd``); return its path.

    Parameters
    ----------
    flight
        Record of the flight.
    path
        File to write; an error leaves no partial file.
    world
        World of the flight; omitted: generated again from the flight's scenario and seed.

    Raises
    ------
    InputError
        If the package rerun-sdk is missing, the file has another suffix or cannot be written, or
        the world cannot be generated again.
    """
    rerun, path = import_rerun("path"), Path(path)
    check_output("path", path, ".rrd")
    stream = _new_stream(rerun, flight)
    world = rebuild_world(flight) if world is None else world

    def write(part: Path) -> None:
        # The file sink of Rerun only logs errors, such as a full disk.
        source = stream.binary_stream()
        stream.send_blueprint(_blueprint(flight))
        _record(stream, flight, world)
        with part.open("wb") as file:
            file.write(source.read(flush=True) or b"")

    try:
        atomic_write(path, write)
    finally:
        stream.disconnect()
    return path


def view_flight(flight: Flight, world: World | None = None) -> None:
    """Open a flight in the Rerun viewer, and return when all data are sent.

    `world` is the world of the flight; omitted: it is generated again from the flight's scenario
    and seed.

    Raises
    ------
    InputError
        If the viewer cannot be started, or was closed before it had all data.
    """
    world = rebuild_world(flight) if world is None else world
    rerun = import_rerun("view")
    stream = _new_stream(rerun, flight)
    _spawn(stream, _blueprint(flight))
    _record(stream, flight, world)
    _finish(stream)


class LiveView:
    """Viewer that shows a flight while it is simulated.

    It is called with the record of each control cycle, as `Simulation.run` does.

    Parameters
    ----------
    world, lander
        True world and lander of the flight.
    start, target
        Position of the lander at the start, and target (3,), m.
    cameras
        Names of the cameras whose images are recorded.
    """

    def __init__(
        self, world: World, lander: Lander, start: Array, target: Array, cameras: list[str]
    ) -> None:
        rerun = import_rerun("--view")
        self.stream = rerun.RecordingStream("lunarsim")
        _spawn(self.stream, flight_blueprint(start, target, cameras, is_live=True))
        self._recording = Recording(self.stream, world, lander)

    def __call__(self, part: Flight) -> None:
        """Show what a control cycle added to the record of the flight."""
        self._recording.add(part)

    def close(self) -> None:
        """Wait until all data are sent; the viewer stays open.

        A flight is complete without its viewer: if that was closed, nothing is raised.
        """
        with suppress(InputError):
            _finish(self.stream)


def _finish(stream: Any) -> None:
    """Send what is left of a stream, and end it.

    A viewer that was closed, or failed to start, must not block the command: InputError.
    """
    try:
        stream.flush(timeout_sec=_FLUSH_TIMEOUT_S)
    except (RuntimeError, ValueError):
        raise InputError(
            "view", None, "the viewer was closed or does not answer", _SAVE, show_value=False
        ) from None
    finally:
        stream.disconnect()


def _new_stream(rerun: Any, flight: Flight) -> Any:
    """Return a stream to Rerun, named after scenario and policy of a flight."""
    stream = rerun.RecordingStream("lunarsim")
    name = parsed_toml(flight.scenario).get("name", "unnamed")
    stream.send_recording_name(f"{name}, {flight.policy}")
    return stream


def _blueprint(flight: Flight) -> Any:
    return flight_blueprint(flight.positions[0], flight.target, list(flight.images))


def _record(stream: Any, flight: Flight, world: World) -> None:
    """Log a flight with its world to a stream."""
    lander = Scenario.world_from_toml(flight.scenario).true_lander()
    Recording(stream, world, lander).add(flight)
