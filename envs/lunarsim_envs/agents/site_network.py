"""Choose sites with a network that scores every site and selects the best one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lunarsim.atomic_files import atomic_write_arrays
from lunarsim.errors import InputError, error_reason
from lunarsim.typing import Array, IntArray
from lunarsim.untrusted_files import read_arrays
from lunarsim_envs.agents.agent_interface import check_sites, incompatible_agent_error
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.sites.site_features import FEATURES, site_features
from lunarsim_envs.sites.site_inputs import SiteInputs

FORMAT = "lunarsim site network 1"


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
        x, good = site_features(inputs)
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
