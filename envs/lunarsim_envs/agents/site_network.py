"""Choose sites with a network that scores every site and selects the best one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lunarsim.atomic_files import atomic_write_arrays
from lunarsim.errors import InputError, error_reason
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.untrusted_files import read_arrays
from lunarsim_envs.agents.agent_interface import check_sites, incompatible_agent_error
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.sites.observations import SITES
from lunarsim_envs.sites.site_inputs import SiteInputs

FORMAT = "lunarsim site network 1"
# Input quantities (features) of a site. The constants below are their scales.
FEATURES = (
    "log-odds of safety", "propellant over that of the present site", "distance", "is the present",
    "has been seen", "altitude", "expected miss", "log-odds under the best",
)  # fmt: skip
_LOG_ODDS, _PROPELLANT, _DISTANCE, _ALTITUDE, _MISS = 5.0, 2.0, 30.0, 200.0, 1.0
# Bounds of p_safe before log-odds: beyond them, model errors of the map dominate.
_LEAST, _MOST = 1e-6, 0.999


def features(inputs: SiteInputs) -> tuple[Array, BoolArray]:
    """Compute network inputs (n, 21, features) of all sites that n landers can choose.

    Option 0 is the current site, option i is candidate site i - 1. Also returns which options are
    available (n, 21). `FEATURES` names the inputs.
    """
    n, m = len(inputs.site), min(SITES, inputs.p_safe.shape[1])
    p = np.zeros((n, SITES + 1))
    p[:, 0] = np.nan_to_num(inputs.here[:, 0], nan=0.0)
    p[:, 1 : m + 1] = inputs.p_safe[:, :m]
    good = np.zeros((n, SITES + 1), np.bool_)
    good[:, 0] = True
    known = np.arange(m) < inputs.count[:, None]
    good[:, 1 : m + 1] = known & np.isfinite(inputs.cost[:, :m])
    p = np.clip(np.where(good, p, 0.0), _LEAST, _MOST)
    odds = np.log(p / (1.0 - p)) / _LOG_ODDS
    stay = np.where(np.isfinite(inputs.here[:, 1]), inputs.here[:, 1], 0.0)
    x = np.zeros((n, SITES + 1, len(FEATURES)))
    x[..., 0] = odds
    more = np.where(good[:, 1 : m + 1], inputs.cost[:, :m], 0.0) - stay[:, None]
    x[:, 1 : m + 1, 1] = np.where(good[:, 1 : m + 1], more, 0.0) / _PROPELLANT
    x[:, 1 : m + 1, 2] = np.where(known, inputs.distance[:, :m], 0.0) / _DISTANCE
    x[:, 0, 3] = 1.0
    x[..., 4] = 1.0
    x[:, 0, 4] = np.isfinite(inputs.here[:, 0])
    x[..., 5] = ((inputs.position[:, 2] - inputs.site[:, 2]) / _ALTITUDE)[:, None]
    x[..., 6] = (np.nan_to_num(inputs.here[:, 2], nan=0.0) / _MISS)[:, None]
    x[..., 7] = odds - np.where(good, odds, -np.inf).max(axis=1, keepdims=True)
    return x, good


@dataclass(frozen=True)
class SiteNetwork:
    """Network that scores landing sites: a linear function plus one hidden tanh layer.

    Attributes
    ----------
    linear
        Weights of the linear function (features,).
    inner, bias, outer
        Input weights (hidden, features), biases (hidden,) and output weights (hidden,) of the
        hidden layer.
    """

    linear: Array
    inner: Array
    bias: Array
    outer: Array

    @classmethod
    def of(cls, flat: Array, hidden: int) -> SiteNetwork:
        """Create a network from its weights as one vector, in the order of `flat`.

        `hidden` is the width of the hidden layer.
        """
        k = len(FEATURES)
        parts = np.split(flat, np.cumsum([k, hidden * k, hidden]))
        return cls(parts[0], parts[1].reshape(hidden, k), parts[2], parts[3])

    @property
    def flat(self) -> Array:
        """All weights as one vector: `linear`, `inner` (by row), `bias`, `outer`."""
        return np.concatenate((self.linear, self.inner.ravel(), self.bias, self.outer))

    def choose(self, inputs: SiteInputs) -> IntArray:
        """Return the available option with the highest score for every lander (n,).

        0 is the current site; i is candidate site i - 1.
        """
        x, good = features(inputs)
        scores = x @ self.linear + np.tanh(x @ self.inner.T + self.bias) @ self.outer
        return np.asarray(np.where(good, scores, -np.inf).argmax(axis=1))

    def save(self, path: Path) -> None:
        """Write the network to a ``.npz`` file."""
        held: dict[str, Any] = {
            name: getattr(self, name) for name in ("linear", "inner", "bias", "outer")
        }
        atomic_write_arrays(path, held | {"format": FORMAT})

    @classmethod
    def load(cls, path: Path) -> SiteNetwork:
        """Read a network written by `save`.

        Raises
        ------
        InputError
            If the file is not a site network, or its layers have inconsistent shapes.
        """
        try:
            found = read_arrays(path)
            if str(found["format"]) != FORMAT:
                raise ValueError(f"the format must be {FORMAT}, not {found['format']}")
            made = cls(*(found[name] for name in ("linear", "inner", "bias", "outer")))
            k, hidden = len(FEATURES), len(made.bias)
            shapes = made.linear.shape, made.inner.shape, made.outer.shape
            if shapes != ((k,), (hidden, k), (hidden,)) or not np.isfinite(made.flat).all():
                raise ValueError("layers have inconsistent shapes or values that are not finite")
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(
                "--agent",
                str(path),
                f"must be a network from train_retarget.py ({error_reason(error)})",
            ) from None
        return made


def is_site_network(path: Path) -> bool:
    """Return whether a file has the format of a site network; false for other files."""
    try:
        return str(read_arrays(path).get("format")) == FORMAT
    except ValueError:
        return False


class SiteNetworkAgent:
    """Choose landing sites in ``Retarget-v1`` with a trained site network.

    The network gets the same inputs as onboard policies.

    Parameters
    ----------
    env
        ``Retarget-v1``.
    network
        Trained network.
    name
        Name of the agent, for messages.

    Raises
    ------
    InputError
        If the environment is another one, or its actions do not include a site.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], network: SiteNetwork, name: str) -> None:
        flown = env.unwrapped
        if not isinstance(flown, RetargetEnv):
            raise incompatible_agent_error(name, env, "Retarget-v1")
        check_sites(name, flown)
        self._env, self._network = flown, network

    def begin(self, rng: np.random.Generator) -> None:
        """Do nothing: the network has no memory and is deterministic."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action that selects the best site and keeps the time-to-go."""
        best = self._network.choose(self._env.flight.inputs)[0]
        return self._env.actions.single_choice("site", int(best))
