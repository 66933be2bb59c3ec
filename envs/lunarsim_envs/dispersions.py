"""Draw scenario values per episode, declared as the dispersions of a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lunarsim.campaign.dispersion_checks import check_dispersions, keys_overlap
from lunarsim.campaign.dispersions import Dispersions, build_dispersions
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.files import read_toml

# Number of random episodes whose values are checked when an environment is created.
_CHECKED_EPISODES = 1000
# Tables that have no effect per episode: an environment reads them once, or the agent replaces
# them.
_NO_EFFECT = ("site_reward", "domain_randomization", "record", "policy")


def dispersions_argument(source: Any, scenario: Scenario) -> Dispersions | None:
    """Build the random scenario values of an environment's episodes from its argument.

    Parameters
    ----------
    source
        Distributions by scenario key, as in the table [dispersions] of a campaign file; the path of
        such a file, of which only [dispersions] and [[correlations]] are used; or None.
    scenario
        Scenario of the environment, which must accept the values.

    Raises
    ------
    InputError
        If a distribution is invalid, the scenario refuses a value, or a key has no effect per
        episode.
    """
    if source is None:
        return None
    if isinstance(source, str | Path):
        given = read_toml(Path(source), "dispersions")
        tables = {name: given.get(name) for name in ("dispersions", "correlations")}
    elif isinstance(source, Mapping):
        tables = {"dispersions": source}
    else:
        raise InputError(
            "dispersions", source,
            "must be a dictionary of distributions by scenario key, or the path of a campaign file",
        )  # fmt: skip
    if not tables["dispersions"]:
        raise InputError(
            "dispersions", str(source), "must have a distribution for at least one scenario key",
            "Omit it for episodes without random values.",
        )  # fmt: skip
    made = build_dispersions(tables, "monte-carlo", 0, _CHECKED_EPISODES)
    for key in made.distributions:
        table = key.partition(".")[0]
        if table in _NO_EFFECT:
            raise InputError(
                f"dispersions.{key}", None,
                f"must not be a key of [{table}], which has no effect per episode",
                show_value=False,
            )  # fmt: skip
    check_dispersions(made, [scenario], {}, _CHECKED_EPISODES)
    return made


def check_option_is_fixed(option: str, key: str, dispersions: Dispersions | None) -> None:
    """Raise an `InputError` if an option of `reset` sets a key that is random.

    `key` is the scenario key of the option.
    """
    for drawn in () if dispersions is None else dispersions.distributions:
        if keys_overlap(drawn, key):
            raise InputError(
                f"options.{option}", None, f"must be omitted, because dispersions draw {drawn}",
                show_value=False,
            )  # fmt: skip
