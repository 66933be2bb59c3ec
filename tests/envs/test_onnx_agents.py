"""Networks in ONNX files fly environments, and files that hold none are refused."""

from __future__ import annotations

import gymnasium
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from lunarsim.errors import InputError
from lunarsim_envs.agents import onnx_network
from lunarsim_envs.agents.registry import agent_of


class Space(gymnasium.Env):
    """An environment that has spaces and nothing else."""

    def __init__(self, seen, action):
        self.observation_space, self.action_space = seen, action


BOX = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
SCALARS = gymnasium.spaces.Box(-10.0, 10.0, (4,), np.float32)


def info(name, shape, kind=TensorProto.FLOAT):
    return helper.make_tensor_value_info(name, kind, shape)


def stored(path, nodes, inputs, outputs, constants=()):
    graph = helper.make_graph(nodes, "network", inputs, outputs, list(constants))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, path)
    return str(path)


def constant(name, values):
    values = np.asarray(values)
    kind = helper.np_dtype_to_tensor_dtype(values.dtype)
    return helper.make_tensor(name, kind, values.shape, values.ravel())


def linear(path, weight, kind=TensorProto.FLOAT):
    """Return the file of a network whose output is ``x @ weight``."""
    weight = np.asarray(weight, dtype=np.float32)
    nodes = [helper.make_node("MatMul", ["x", "w"], ["y"])]
    inputs, outputs = [info("x", ["n", len(weight)])], [info("y", ["n", weight.shape[1]], kind)]
    return stored(path, nodes, inputs, outputs, [constant("w", weight)])


def test_a_box_action_is_the_output_clipped(tmp_path):
    weight = np.arange(12.0).reshape(4, 3) / 10.0
    agent = agent_of(linear(tmp_path / "a.onnx", weight), Space(SCALARS, BOX))
    seen = np.array([0.1, -0.2, 0.3, 5.0], dtype=np.float32)
    agent.begin(np.random.default_rng(0))
    expected = np.clip(seen @ weight, -1.0, 1.0)
    assert agent.act(seen, {}) == pytest.approx(expected, abs=1e-6)


def test_scores_choose_the_best_allowed_option(tmp_path):
    space = Space(SCALARS, gymnasium.spaces.Discrete(4))
    agent = agent_of(linear(tmp_path / "a.onnx", np.eye(4)), space)
    seen = np.array([1.0, 3.0, 2.0, 0.0], dtype=np.float32)
    assert agent.act(seen, {}) == 1
    assert agent.act(seen, {"action_mask": np.array([1, 0, 1, 1], dtype=np.int8)}) == 2


def test_scores_of_several_choices_are_split(tmp_path):
    space = Space(SCALARS, gymnasium.spaces.MultiDiscrete([1, 2, 1]))
    agent = agent_of(linear(tmp_path / "a.onnx", np.eye(4)), space)
    seen = np.array([1.0, 3.0, 2.0, 9.0], dtype=np.float32)
    assert agent.act(seen, {}).tolist() == [0, 0, 0]
    assert agent.act(seen, {"action_mask": np.array([1, 0, 1, 1])}).tolist() == [0, 1, 0]


def test_an_option_that_does_not_exist_is_refused(tmp_path):
    nodes = [helper.make_node("ArgMax", ["x"], ["y"], axis=1, keepdims=0)]
    inputs, outputs = [info("x", [1, 4])], [info("y", [1], TensorProto.INT64)]
    path = stored(tmp_path / "a.onnx", nodes, inputs, outputs)
    agent = agent_of(path, Space(SCALARS, gymnasium.spaces.Discrete(3)))
    assert agent.act(np.array([0, 0, 5, 0]), {}) == 2
    with pytest.raises(InputError, match=r"an output for Discrete\(3\)"):
        agent.act(np.array([0, 0, 0, 5]), {})


def test_named_inputs_and_the_mask_are_fed(tmp_path):
    seen = gymnasium.spaces.Dict({"a": SCALARS, "b": SCALARS, "c": BOX})
    nodes = [
        helper.make_node("Add", ["b", "a"], ["sum"]),
        helper.make_node("Mul", ["sum", "action_mask"], ["masked"]),
        helper.make_node("ArgMax", ["masked"], ["y"], axis=1, keepdims=0),
    ]
    inputs = [info("b", [1, 4]), info("a", [1, 4]), info("action_mask", [1, 4])]
    path = stored(tmp_path / "a.onnx", nodes, inputs, [info("y", [1], TensorProto.INT64)])
    agent = agent_of(path, Space(seen, gymnasium.spaces.Discrete(4)))
    shown = {"a": np.array([0, 1, 5, 0]), "b": np.array([0, 3, 0, 1]), "c": np.zeros(3)}
    assert agent.act(shown, {"action_mask": np.array([1, 1, 1, 1])}) == 2
    assert agent.act(shown, {"action_mask": np.array([1, 1, 0, 1])}) == 1


def test_networks_of_other_sizes_are_refused(tmp_path):
    space = Space(SCALARS, BOX)
    wrong = linear(tmp_path / "seen.onnx", np.zeros((5, 3)))
    with pytest.raises(InputError, match="inputs that fit this environment"):
        agent_of(wrong, space)
    with pytest.raises(InputError, match="an output for Box"):
        agent_of(linear(tmp_path / "action.onnx", np.zeros((4, 2))), space)
    with pytest.raises(InputError, match="finite numbers"):
        agent_of(linear(tmp_path / "nan.onnx", np.full((4, 3), np.nan)), space)
    named = gymnasium.spaces.Dict({"a": SCALARS})
    with pytest.raises(InputError, match="no inputs except a, not with x"):
        agent_of(linear(tmp_path / "names.onnx", np.zeros((4, 3))), Space(named, BOX))
    mask = [info("x", [1, 4]), info("action_mask", [1, 4])]
    nodes = [helper.make_node("Add", ["x", "action_mask"], ["y"])]
    path = stored(tmp_path / "mask.onnx", nodes, mask, [info("y", [1, 4])])
    agent = agent_of(path, Space(SCALARS, gymnasium.spaces.Discrete(4)))
    with pytest.raises(InputError, match="no action masks"):
        agent.act(np.zeros(4), {})


def test_other_files_are_refused_by_name(tmp_path):
    (tmp_path / "text.onnx").write_text("plain text")
    (tmp_path / "empty.onnx").write_bytes(b"")
    with (tmp_path / "large.onnx").open("wb") as file:
        file.truncate(onnx_network.MAX_BYTES + 1)
    for name, why in (("text", "an ONNX network"), ("empty", "an ONNX network"),
                      ("large", "at most 64 MB")):  # fmt: skip
        with pytest.raises(InputError, match=rf"{why}.*{name}\.onnx"):
            agent_of(str(tmp_path / f"{name}.onnx"), Space(SCALARS, BOX))


@pytest.mark.parametrize("place", ["../secret", "{folder}/secret", "secret"])
def test_weights_in_other_files_are_refused(tmp_path, place, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for folder in (tmp_path, tmp_path / "here"):
        (folder / "secret").write_bytes(np.zeros((4, 3), dtype=np.float32).tobytes())
    weight = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[4, 3])
    weight.data_location = TensorProto.EXTERNAL
    weight.external_data.add(key="location", value=place.format(folder=tmp_path))
    nodes = [helper.make_node("MatMul", ["x", "w"], ["y"])]
    graph = helper.make_graph(nodes, "n", [info("x", [1, 4])], [info("y", [1, 3])], [weight])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path = tmp_path / "here" / "a.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match=r"a\.onnx"):
        agent_of(str(path), Space(SCALARS, BOX))


def test_a_network_that_never_ends_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(onnx_network, "MAX_SECONDS", 0.2)
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["on"]),
            helper.make_node("Add", ["carried", "carried"], ["next"]),
        ],
        "body",
        [
            info("i", [], TensorProto.INT64), info("go", [], TensorProto.BOOL),
            info("carried", [1, 4]),
        ],
        [info("on", [], TensorProto.BOOL), info("next", [1, 4])],
    )  # fmt: skip
    nodes = [helper.make_node("Loop", ["", "true", "x"], ["y"], body=body)]
    path = stored(
        tmp_path / "a.onnx", nodes, [info("x", [1, 4])], [info("y", [1, 4])],
        [constant("true", np.array(True))],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"computation time of at most 0\.2 s"):
        agent_of(path, Space(SCALARS, SCALARS))
