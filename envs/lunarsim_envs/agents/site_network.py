"""A network that chooses among sites: every site is scored alike, the best one is flown to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.array_files import read_arrays
from lunarsim.errors import InputError
from lunarsim.whole_arrays import write_arrays_whole
from lunarsim_envs.agents.contract import check_sites, refuse
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.sites.parts import SITES
from lunarsim_envs.sites.sights import Sights

Array = NDArray[np.float64]

FORMAT = "lunarsim site network 1"
# What the network is shown of a site, and what each is measured by.
FEATURES = (
    "log-odds of safety", "propellant over that of the present site", "distance", "is the present",
    "has been seen", "altitude", "expected miss", "log-odds under the best",
)  # fmt: skip
_LOG_ODDS, _PROPELLANT, _DISTANCE, _ALTITUDE, _MISS = 5.0, 2.0, 30.0, 200.0, 1.0
# Log-odds are cut where the map's own model errors matter more than its figures.
_LEAST, _MOST = 1e-6, 0.999


def features(sights: Sights) -> tuple[Array, NDArray[np.bool_]]:
    """Return what is seen of the options (n, 21, features), and which can be had (n, 21).

    Option 0 is the present site, the others are the rows of the actions.
    """
    n, m = len(sights.site), min(SITES, sights.p_safe.shape[1])
    p = np.zeros((n, SITES + 1))
    p[:, 0] = np.nan_to_num(sights.here[:, 0], nan=0.0)
    p[:, 1 : m + 1] = sights.p_safe[:, :m]
    good = np.zeros((n, SITES + 1), np.bool_)
    good[:, 0] = True
    known = np.arange(m) < sights.count[:, None]
    good[:, 1 : m + 1] = known & np.isfinite(sights.cost[:, :m])
    p = np.clip(np.where(good, p, 0.0), _LEAST, _MOST)
    odds = np.log(p / (1.0 - p)) / _LOG_ODDS
    stay = np.where(np.isfinite(sights.here[:, 1]), sights.here[:, 1], 0.0)
    x = np.zeros((n, SITES + 1, len(FEATURES)))
    x[..., 0] = odds
    more = np.where(good[:, 1 : m + 1], sights.cost[:, :m], 0.0) - stay[:, None]
    x[:, 1 : m + 1, 1] = np.where(good[:, 1 : m + 1], more, 0.0) / _PROPELLANT
    x[:, 1 : m + 1, 2] = np.where(known, sights.distance[:, :m], 0.0) / _DISTANCE
    x[:, 0, 3] = 1.0
    x[..., 4] = 1.0
    x[:, 0, 4] = np.isfinite(sights.here[:, 0])
    x[..., 5] = ((sights.position[:, 2] - sights.site[:, 2]) / _ALTITUDE)[:, None]
    x[..., 6] = (np.nan_to_num(sights.here[:, 2], nan=0.0) / _MISS)[:, None]
    x[..., 7] = odds - np.where(good, odds, -np.inf).max(axis=1, keepdims=True)
    return x, good


@dataclass(frozen=True)
class SiteNetwork:
    """Scores of options: linear in their features, and a layer of tanh beside it.

    Attributes
    ----------
    linear
        Weights of the features (features,).
    inner, bias, outer
        Of the layer (hidden, features), (hidden,), (hidden,).
    """

    linear: Array
    inner: Array
    bias: Array
    outer: Array

    @classmethod
    def of(cls, flat: Array, hidden: int) -> SiteNetwork:
        """Return the network of one row of numbers, see `flat`."""
        k = len(FEATURES)
        parts = np.split(flat, np.cumsum([k, hidden * k, hidden]))
        return cls(parts[0], parts[1].reshape(hidden, k), parts[2], parts[3])

    @property
    def flat(self) -> Array:
        """All weights one after another."""
        return np.concatenate((self.linear, self.inner.ravel(), self.bias, self.outer))

    def choose(self, sights: Sights) -> NDArray[np.int64]:
        """Return the best option of every lander (n,)."""
        x, good = features(sights)
        scores = x @ self.linear + np.tanh(x @ self.inner.T + self.bias) @ self.outer
        return np.asarray(np.where(good, scores, -np.inf).argmax(axis=1))

    def save(self, path: Path) -> None:
        """Write it as ``.npz``."""
        held: dict[str, Any] = {
            name: getattr(self, name) for name in ("linear", "inner", "bias", "outer")
        }
        write_arrays_whole(path, held | {"format": FORMAT})

    @classmethod
    def load(cls, path: Path) -> SiteNetwork:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is something else, or its layers do not fit.
        """
        try:
            found = read_arrays(path)
            if str(found["format"]) != FORMAT:
                raise ValueError(f"its format is {found['format']}")
            made = cls(*(found[name] for name in ("linear", "inner", "bias", "outer")))
            k, hidden = len(FEATURES), len(made.bias)
            shapes = made.linear.shape, made.inner.shape, made.outer.shape
            if shapes != ((k,), (hidden, k), (hidden,)) or not np.isfinite(made.flat).all():
                raise ValueError("layers that do not fit, or are not finite")
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(
                "--agent", str(path), f"a network of train_retarget.py ({error})"
            ) from None
        return made


def is_site_network(path: Path) -> bool:
    """Tell whether a file says that it is one; what is no file of arrays is none."""
    try:
        return str(read_arrays(path).get("format")) == FORMAT
    except ValueError:
        return False


class SiteNetworkAgent:
    """A network that chooses in ``Retarget-v0``; it is shown what the onboard computer shows.

    Parameters
    ----------
    env
        Which.
    network, name
        Of the file, for messages.

    Raises
    ------
    InputError
        If the environment is another, or its actions choose no sites.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], network: SiteNetwork, name: str) -> None:
        flown = env.unwrapped
        if not isinstance(flown, RetargetEnv):
            raise refuse(name, env, "Retarget-v0")
        check_sites(name, flown)
        self._env, self._network = flown, network

    def begin(self, rng: np.random.Generator) -> None:
        """Draw nothing."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the best action; the time-to-go stays as it comes."""
        best = self._network.choose(self._env.flight.sights)[0]
        return self._env.actions.alone("site", int(best))
