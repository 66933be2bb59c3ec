"""Handle errors, options, scenario loading and progress bars for all commands."""

from __future__ import annotations

import errno
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from lunarsim.cli_start import INTERRUPTED, acknowledge_interrupt, interrupt_message
from lunarsim.errors import InputError, RenderingError

if TYPE_CHECKING:
    from rich.console import Console

    from lunarsim.campaign.cache import DiskCache
    from lunarsim.scenario import Scenario

F = TypeVar("F", bound=Callable[..., Any])

PATH = click.Path(path_type=Path)


# Disk errors (full, over quota, file too large, damaged) exit with code 1: not a usage mistake.
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


class IntRange(click.IntRange):
    """Type of integer options within bounds; errors call it "integer", not a range."""

    name = "integer"


class FloatRange(click.FloatRange):
    """Type of number options within bounds; errors call it "float", not a range.

    NaN, which click accepts within any bounds, is refused.
    """

    name = "float"

    def convert(self, value: Any, param: Any, ctx: click.Context | None) -> float:
        """Return the number, or fail if it is outside the bounds or NaN."""
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return number


class ErrorReportingGroup(click.Group):
    """Click command group that reports a user's mistake as one line with exit code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command and turn its known exceptions into messages and exit codes."""
        try:
            return super().invoke(ctx)
        except click.exceptions.NoArgsIsHelpError:
            raise
        except click.UsageError as error:
            where = ctx.command_path if error.ctx is None else error.ctx.command_path
            _exit_with_message(ctx, f"{error.format_message()} See `{where} --help`.", 2)
        except InputError as error:
            _exit_with_message(ctx, str(error), 2)
        except RenderingError as error:
            _exit_with_message(ctx, str(error), 1)
        except KeyboardInterrupt as error:
            acknowledge_interrupt()
            _exit_with_message(ctx, interrupt_message(error), INTERRUPTED, prefix="")
        except MemoryError as error:
            _exit_with_message(
                ctx, f"out of memory: {error or 'allocation failed'}. Use smaller sizes.", 1
            )
        except OSError as error:
            if error.filename is None:
                # A pipe closed by its reader is no error: click ends the command.
                if isinstance(error, BrokenPipeError):
                    raise
                _exit_with_message(ctx, f"output: {error.strerror or error}", 1)
            _exit_with_message(
                ctx, f"{error.filename}: {error.strerror}", 1 if error.errno in _DISK_ERRORS else 2
            )


def _exit_with_message(
    ctx: click.Context, message: str, code: int, prefix: str = "error: "
) -> None:
    """Print prefix and message as one line on stderr and exit with a code."""
    click.echo(prefix + " ".join(message.split()), err=True)
    ctx.exit(code)


# --- options ----------------------------------------------------------------------------------

_FILE = click.argument("scenario", type=PATH)
_SET = click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Set a scenario key, for example sun.elevation_deg=5. Repeat the option for several keys.",
)  # fmt: skip
SEED = click.option(
    "--seed",
    type=IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
FLIGHT = click.option(
    "--flight", type=IntRange(min=0), default=0, show_default=True,
    help="Index of the flight. Terrain, start and noise follow from --seed and --flight.",
)  # fmt: skip


def _allow(ctx: click.Context, _: click.Parameter, names: tuple[str, ...]) -> None:
    """Allow files to run code of the named Python modules while the command runs."""
    from lunarsim.parts.module_permission import modules_allowed

    try:
        ctx.with_resource(modules_allowed(names))
    except InputError as error:
        raise error.with_field("--allow-module") from None


def _allow_programs(ctx: click.Context, _: click.Parameter, paths: tuple[Path, ...]) -> None:
    """Allow files to run the named programs and libraries while the command runs."""
    from lunarsim.parts.program_permission import programs_allowed

    try:
        ctx.with_resource(programs_allowed(paths))
    except InputError as error:
        raise error.with_field("--allow-program") from None


_ALLOW_MODULE = click.option(
    "--allow-module", multiple=True, metavar="MODULE", expose_value=False, callback=_allow,
    help="Allow scenario files and other input files to run code of this Python module or package. "
    "Repeatable.",
)  # fmt: skip
_ALLOW_PROGRAM = click.option(
    "--allow-program", multiple=True, type=PATH, metavar="FILE", expose_value=False,
    callback=_allow_programs,
    help="Allow scenario files and other input files to run this program or shared library. "
    "Repeatable.",
)  # fmt: skip


def allow_options(command: F) -> F:
    """Add ``--allow-module`` and ``--allow-program`` to a click command; return it."""
    return _ALLOW_MODULE(_ALLOW_PROGRAM(command))


def allow_named_modules(*texts: str | None) -> None:
    """Allow files to run the modules that the user names as "module:Class".

    The permission ends with the current command. Texts without such a name, and None, are ignored.
    """
    from lunarsim.parts.module_permission import find_module_names, modules_allowed

    click.get_current_context().with_resource(modules_allowed(find_module_names(texts)))


def scenario_options(command: F) -> F:
    """Add SCENARIO, ``--set`` and permissions to a click command; return it."""
    return _FILE(_SET(allow_options(command)))


_CACHE = click.option(
    "--cache", type=PATH, default=None, show_default="lunarsim/worlds in the user's cache folder",
    help="Folder that stores true terrain maps, so that later runs need not compute them again.",
)  # fmt: skip
_CACHE_SIZE = click.option(
    "--cache-size", type=FloatRange(min=0.0), default=4.0, show_default=True,
    help="Maximum size of the folder of true terrain maps (GiB); 0: store no maps. It does not "
    "change the results.",
)  # fmt: skip


def cache_options(command: F) -> F:
    """Add the options of the cache of true terrain maps to a click command; return it."""
    return _CACHE(_CACHE_SIZE(command))


def open_cache(folder: Path | None, gigabytes: float) -> DiskCache | None:
    """Return the cache of true terrain maps in a folder, or None if disabled (size 0).

    If `folder` is None, the default folder is used. `gigabytes` is the maximum size, GiB.
    """
    from lunarsim.campaign.cache import default_cache_folder, open_cache

    if not math.isfinite(gigabytes):
        raise InputError("--cache-size", gigabytes, "must be finite", "Use 0 to disable the cache.")
    if gigabytes == 0.0:
        return None
    return open_cache(default_cache_folder() if folder is None else folder, int(gigabytes * 2**30))


def load_scenario(
    path_or_name: Path,
    changes: tuple[str, ...],
    *,
    is_flown: bool = True,
    parts: Mapping[str, str | None] | None = None,
) -> Scenario:
    """Load a scenario, apply command-line changes, and print warnings on stderr.

    Parameters
    ----------
    path_or_name
        TOML file, or name of a scenario supplied with lunarsim.
    changes
        Texts ``KEY=VALUE``. They apply after the kinds in `parts` have been selected.
    parts
        Selected kind by contract (such as "guidance" or "policy"), as given by options such as
        ``--guidance``; None keeps the scenario's kind. A kind that differs from the scenario's has
        its default settings.
    is_flown
        Whether a flight follows; only then are warnings printed.

    Raises
    ------
    InputError
        If the file or a change is invalid.
    """
    from lunarsim.scenario import Scenario
    from lunarsim.scenario.changes import with_changes
    from lunarsim.scenario.scenario_warnings import warnings_for
    from lunarsim.scenario.shipped import found

    allow_named_modules(*changes, *filter(None, (parts or {}).values()))
    loaded = Scenario.load(found(path_or_name))
    selected = [
        change
        for contract, kind in (parts or {}).items()
        for change in _selection(loaded, contract, kind)
    ]
    loaded = with_changes(loaded, [*selected, *changes])
    for note in warnings_for(loaded) if is_flown else ():
        click.echo(f"warning: {note}", err=True)
    return loaded


def _selection(scenario: Scenario, contract: str, kind: str | None) -> list[str]:
    """Return the change that selects a component of another kind.

    Its keys have the defaults of that kind. `contract` is the type of component, such as
    "guidance"; None as `kind` changes nothing.
    """
    from lunarsim.parts import resolve

    if kind is None or kind == getattr(scenario, contract).kind:
        return []
    resolve(contract, kind, f"--{contract}")
    return [f'{contract}.kind="{kind}"']


# --- output -------------------------------------------------------------------------------------


def wide_console(width: int) -> Console:
    """Return a Rich console for tables, `width` columns wide if not on a terminal."""
    from lunarsim.console import plain_console

    return plain_console(None if sys.stdout.isatty() else width)


@contextmanager
def add_to_interrupt_message(text: str) -> Iterator[None]:
    """Add a text to the message of an interrupt that occurs in a `with` block.

    The text states, for instance, which files have been written.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(text) from None


@contextmanager
def progress_bar(name: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on stderr in a `with` block; yield a function to advance it.

    `name` is the text beside the bar, `total` the number of steps.
    """
    from lunarsim.console import plain_console, plain_progress

    with plain_progress(plain_console(stderr=True)) as bar:
        task = bar.add_task(name, total=total)
        try:
            yield lambda n: bar.advance(task, n)
        except (InputError, OSError):
            bar.live.transient = True  # print nothing but the error
            bar.console.quiet = not bar.console.is_terminal
            raise
