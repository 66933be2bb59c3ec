"""Fly networks from ONNX files.

Any framework can export such files, and they contain no code.
These agents need the extra ``onnx``.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, missing_package

MAX_BYTES = 64_000_000
# Time limit of one evaluation, s; it stops networks with endless loops.
MAX_SECONDS = 5.0

_MASK = "action_mask"


def _load_session(path: Path) -> Any:
    """Load an ONNX network into an onnxruntime session.

    The session uses one thread, so that results are reproducible. The network is read from memory,
    and external weight files are disabled by an invalid folder. If the file is too large or not an
    ONNX network, or onnxruntime is missing, an `InputError` is raised.
    """
    try:
        import onnxruntime  # noqa: PLC0415  (an extra)
    except ImportError:
        raise missing_package("--agent", "onnxruntime", "onnx") from None
    if path.stat().st_size > MAX_BYTES:
        raise InputError("--agent", str(path), f"must be a file of at most {MAX_BYTES / 1e6:g} MB")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry(
        "session.model_external_initializers_file_folder_path", os.devnull
    )
    try:
        return onnxruntime.InferenceSession(
            path.read_bytes(), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # onnxruntime has a separate exception type for each status
        raise InputError(
            "--agent", str(path), f"must be an ONNX network ({_first_line(error)})"
        ) from None


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0][:120]


class OnnxAgent:
    """Fly a memoryless, deterministic network from an ONNX file.

    Inputs have a batch axis of length 1 and type float32. If the observation is a Box, the network
    has one input with any name. If the observation is a Dict, the inputs have the names of its
    entries. An input ``action_mask`` gets ``info["action_mask"]`` (1: allowed). The first output is
    the action:

    ================  ==================================================================
    action space      first output
    ================  ==================================================================
    Box               the action, clipped to the space
    Discrete(n)       an integer, or n scores; the allowed option with the maximum is used
    MultiDiscrete     an integer per choice, or the scores of all choices in one row
    ================  ==================================================================

    Parameters
    ----------
    env
        Environment with observations and actions that fit the network.
    path
        ONNX file.

    Raises
    ------
    InputError
        If the file is not such a network, or onnxruntime (the extra ``onnx``) is missing.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], path: Path) -> None:
        self._path = path
        self._space = env.action_space
        self._session = _load_session(path)
        self._inputs = {one.name: one.type for one in self._session.get_inputs()}
        space = env.observation_space
        names = list(space) if isinstance(space, gymnasium.spaces.Dict) else None
        seen = [name for name in self._inputs if name != _MASK]
        if names is None and len(seen) != 1:
            raise self._error(
                f"one input in addition to {_MASK}, not with {', '.join(seen) or 'none'}"
            )
        if names is not None and not set(seen) <= set(names):
            raise self._error(f"no inputs except {', '.join(names)}, not with {', '.join(seen)}")
        sizes = _option_counts(self._space)
        mask = np.ones(sum(sizes)) if sizes else np.ones(1)
        self.act(_zero_observation(space), {_MASK: mask})

    def _error(self, wanted: str) -> InputError:
        return InputError("--agent", str(self._path), f"must be a network with {wanted}")

    def begin(self, rng: np.random.Generator) -> None:
        """Do nothing: the network has no memory and is deterministic."""

    def act(self, observation: Any, info: dict[str, Any]) -> Any:
        """Return the action for an observation.

        Raises
        ------
        InputError
            If the network fails, takes too long, or returns an invalid action.
        """
        return self._action(self._run(observation, info), info)

    def _run(self, observation: Any, info: dict[str, Any]) -> NDArray[Any]:
        """Evaluate the network on an observation and return its first output, flattened."""
        import onnxruntime  # noqa: PLC0415

        fed: dict[str, NDArray[Any]] = {}
        for name, kind in self._inputs.items():
            if name == _MASK:
                if _MASK not in info:
                    raise self._error(
                        f"no input {_MASK}, because this environment has no action masks"
                    )
                value = info[_MASK]
            else:
                value = observation[name] if isinstance(observation, dict) else observation
            dtype = np.bool_ if kind == "tensor(bool)" else np.float32
            fed[name] = np.asarray(value, dtype=dtype)[None]
        options = onnxruntime.RunOptions()
        options.log_severity_level = 4
        timer = threading.Timer(MAX_SECONDS, setattr, (options, "terminate", True))
        timer.daemon = True
        timer.start()
        try:
            return np.asarray(self._session.run(None, fed, options)[0]).ravel()
        except Exception as error:  # onnxruntime has a separate exception type for each status
            if options.terminate:
                raise self._error(f"a computation time of at most {MAX_SECONDS:g} s") from None
            raise self._error(f"inputs that fit this environment ({_first_line(error)})") from None
        finally:
            timer.cancel()

    def _action(self, output: NDArray[Any], info: dict[str, Any]) -> Any:
        """Convert the flattened output of the network to an action of the environment.

        A Box action is clipped to its space; scores give the allowed option with the maximum score,
        by the mask in `info`. An output of another size or type raises an `InputError`.
        """
        space, sizes = self._space, _option_counts(self._space)
        if output.dtype.kind not in "iuf" or not np.isfinite(output).all():
            raise self._error("finite numbers as its first output")
        if isinstance(space, gymnasium.spaces.Box) and output.size == np.prod(space.shape):
            return np.clip(output.reshape(space.shape), space.low, space.high).astype(space.dtype)
        if sizes and output.dtype.kind == "f" and output.size == sum(sizes):
            allowed = np.asarray(info.get(_MASK, np.ones(sum(sizes))), dtype=bool).ravel()
            scores = np.where(allowed, output, -np.inf) if allowed.size == output.size else output
            ends = np.cumsum(sizes)[:-1]
            output = np.array([one.argmax() for one in np.split(scores, ends)])
            output = output + getattr(space, "start", 0)
        if sizes and output.dtype.kind in "iu" and output.size == len(sizes):
            action = output.astype(np.int64)
            chosen = action[0] if isinstance(space, gymnasium.spaces.Discrete) else action
            if space.contains(chosen):
                return chosen
        raise self._error(
            f"an output for {space}, not with {output.size} values of type {output.dtype}"
        )


def _zero_observation(space: gymnasium.Space[Any]) -> Any:
    """Return an observation of zeros, to test a network before the first episode."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: np.zeros(part.shape or (), part.dtype) for name, part in space.items()}
    return np.zeros(space.shape or (), space.dtype)


def _option_counts(space: gymnasium.Space[Any]) -> list[int]:
    """Return the number of options of each discrete choice; empty for Box actions."""
    if isinstance(space, gymnasium.spaces.Discrete):
        return [int(space.n)]
    if isinstance(space, gymnasium.spaces.MultiDiscrete):
        return [int(n) for n in space.nvec.ravel()]
    return []
