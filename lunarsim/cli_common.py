"""What all commands share: mistakes as one line, scenarios by file or name, options, progress."""

from __future__ import annotations

import errno
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from lunarsim.cli_start import INTERRUPTED, end_of, heard
from lunarsim.errors import InputError, RenderingError

if TYPE_CHECKING:
    from rich.console import Console

    from lunarsim.campaign.cache import DiskCache
    from lunarsim.scenario import Scenario

F = TypeVar("F", bound=Callable[..., Any])

PATH = click.Path(path_type=Path)


# Errors of a disk, which are not the user's mistake: full, over quota, file too large, damaged.
_STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


class IntRange(click.IntRange):
    """Whole numbers within bounds, named as what they are where one is none."""

    name = "integer"


class FloatRange(click.FloatRange):
    """Numbers within bounds, named as what they are where one is none."""

    name = "float"


class Group(click.Group):
    """Turns a user's mistake into one line and exit code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except click.exceptions.NoArgsIsHelpError:
            raise
        except click.UsageError as error:
            where = ctx.command_path if error.ctx is None else error.ctx.command_path
            _end(ctx, f"{error.format_message()} (`{where} --help` tells more)", 2)
        except InputError as error:
            _end(ctx, str(error), 2)
        except RenderingError as error:
            _end(ctx, str(error), 1)
        except KeyboardInterrupt as error:
            heard()
            _end(ctx, end_of(error), INTERRUPTED, kind="")
        except MemoryError as error:
            _end(ctx, f"memory: {error or 'not enough'}; smaller sizes take less", 1)
        except OSError as error:
            if error.filename is None:
                # A pipe that its reader has closed is nobody's error: click ends the command.
                if isinstance(error, BrokenPipeError):
                    raise
                _end(ctx, f"output: {error.strerror or error}", 1)
            _end(ctx, f"{error.filename}: {error.strerror}", 1 if error.errno in _STORAGE else 2)


def _end(ctx: click.Context, message: str, code: int, kind: str = "error: ") -> None:
    """Write a message as one line and leave."""
    click.echo(kind + " ".join(message.split()), err=True)
    ctx.exit(code)


# --- options ----------------------------------------------------------------------------------

_FILE = click.argument("scenario", type=PATH)
_SET = click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Another value of a key, such as sun.elevation_deg=5; may be repeated.",
)  # fmt: skip
SEED = click.option("--seed", type=IntRange(min=0), default=1, show_default=True, help="Root seed.")
FLIGHT = click.option(
    "--flight", type=IntRange(min=0), default=0, show_default=True,
    help="Index of the flight: world and noise derive from the seed and this.",
)  # fmt: skip


def _allow(ctx: click.Context, _: click.Parameter, names: tuple[str, ...]) -> None:
    """Allow modules as long as the command runs."""
    from lunarsim.parts.allowed import allowing

    try:
        ctx.with_resource(allowing(names))
    except InputError as error:
        raise error.renamed("--allow-module") from None


ALLOW_MODULE = click.option(
    "--allow-module", multiple=True, metavar="MODULE", expose_value=False, callback=_allow,
    help="Run code of this module if a file names it; repeatable.",
)  # fmt: skip


def allow_typed(*texts: str | None) -> None:
    """Allow the modules that the user named as "module:Class" on the command line."""
    from lunarsim.parts.allowed import allowing, modules_in

    click.get_current_context().with_resource(allowing(modules_in(texts)))


def scenario_options(command: F) -> F:
    """Give a command the argument SCENARIO, and the options ``--set`` and ``--allow-module``."""
    return _FILE(_SET(ALLOW_MODULE(command)))


_CACHE = click.option(
    "--cache", type=PATH, default=None, show_default="lunarsim/worlds in the user's cache folder",
    help="Folder where the truth about grounds is kept between campaigns.",
)  # fmt: skip
_CACHE_SIZE = click.option(
    "--cache-size", type=FloatRange(min=0.0), default=4.0, show_default=True,
    help="Of that folder at most, GiB; 0: nothing is kept. Results do not depend on it.",
)  # fmt: skip


def cache_options(command: F) -> F:
    """Give a command the options of the cache of truth about grounds."""
    return _CACHE(_CACHE_SIZE(command))


def opened_cache(folder: Path | None, gigabytes: float) -> DiskCache | None:
    """Return the cache of a folder, None where nothing is kept."""
    from lunarsim.campaign.cache import opened, standard_folder

    if not math.isfinite(gigabytes):
        raise InputError("--cache-size", gigabytes, "a finite number of GiB; 0: nothing is kept")
    if gigabytes == 0.0:
        return None
    return opened(standard_folder() if folder is None else folder, int(gigabytes * 2**30))


def load_scenario(
    given: Path,
    changes: tuple[str, ...],
    *,
    flown: bool = True,
    parts: Mapping[str, str | None] | None = None,
) -> Scenario:
    """Return a scenario with changes of the command line; tell on stderr what is odd about it.

    Parameters
    ----------
    given
        A file, or the name of a scenario that comes with the package.
    changes
        ``KEY=VALUE`` each.
    parts
        By contract the kind of part that an option such as ``--guidance`` names, or None. A kind
        that is not the scenario's starts from its defaults. Changes apply to the named part.
    flown
        Whether a flight follows; pictures and maps of the ground use more, and less, of it.

    Raises
    ------
    InputError
        If the file or a change will not do.
    """
    from lunarsim.scenario import Scenario
    from lunarsim.scenario.changes import with_changes
    from lunarsim.scenario.notes import notes_on
    from lunarsim.scenario.shipped import found

    allow_typed(*changes, *filter(None, (parts or {}).values()))
    loaded = Scenario.load(found(given))
    for contract, kind in (parts or {}).items():
        loaded = _with_part(loaded, contract, kind)
    loaded = with_changes(loaded, changes)
    for note in notes_on(loaded) if flown else ():
        click.echo(f"warning: {note}", err=True)
    return loaded


def _with_part(scenario: Scenario, contract: str, kind: str | None) -> Scenario:
    """Return a scenario with a part that an option names, with that kind's defaults."""
    from lunarsim.parts import resolve

    if kind is None or kind == getattr(scenario, contract).kind:
        return scenario
    resolve(contract, kind, f"--{contract}")
    change: Any = {contract: {"kind": kind}}
    return scenario.changed(**change)


# --- what is shown meanwhile --------------------------------------------------------------------


def wide_console(width: int) -> Console:
    """Return a console for tables, `width` columns wide where it is no terminal."""
    from lunarsim.console import plain_console

    return plain_console(None if sys.stdout.isatty() else width)


@contextmanager
def kept_if_interrupted(what: str) -> Iterator[None]:
    """Say in the line about an interrupt what is there all the same."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(what) from None


@contextmanager
def progress_bar(name: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar on stderr; what is yielded takes the number of things done since the last call."""
    from lunarsim.console import plain_console, plain_progress

    with plain_progress(plain_console(stderr=True)) as bar:
        task = bar.add_task(name, total=total)
        try:
            yield lambda n: bar.advance(task, n)
        except (InputError, OSError):
            bar.live.transient = True  # the error is the only line
            bar.console.quiet = not bar.console.is_terminal
            raise
