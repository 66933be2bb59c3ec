"""Find agents by name, by file or as ``module:Name``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium

from lunarsim.errors import InputError, suggestion
from lunarsim.parts.module_permission import allow_modules
from lunarsim.parts.registry import kinds
from lunarsim_envs.agents.agent_interface import Agent
from lunarsim_envs.agents.custom_agents import contract_of_custom_part, custom_agent
from lunarsim_envs.agents.guidance_laws import GuidanceLawAgent, PolynomialLawAgent
from lunarsim_envs.agents.network import Network, NetworkAgent
from lunarsim_envs.agents.onnx_network import OnnxAgent
from lunarsim_envs.agents.policies import PolicyAgent
from lunarsim_envs.agents.sb3_agents import Sb3Agent, check_trust
from lunarsim_envs.agents.site_network import SiteNetwork, SiteNetworkAgent, is_site_network
from lunarsim_envs.agents.trivial_agents import HoverAgent, RandomAgent, ZeroAgent

BUILT_IN: dict[str, Any] = {
    "zero": ZeroAgent, "random": RandomAgent, "hover": HoverAgent, "polynomial": PolynomialLawAgent
}  # fmt: skip
# Folder of the trained networks that come with the package.
_SHIPPED = Path(__file__).parent / "trained"


def packaged_agents() -> dict[str, Path]:
    """Return the files of the trained networks supplied with lunarsim_envs, by name."""
    return {path.stem: path for path in sorted(_SHIPPED.glob("*.npz"))}


def known_agents() -> dict[str, str]:
    """Return the agents that can be selected by name, with the type of each.

    Examples
    --------
    >>> known_agents()["apollo"]
    'guidance law'
    """
    names = dict.fromkeys(BUILT_IN, "built in")
    names |= dict.fromkeys(packaged_agents(), "trained network")
    names |= dict.fromkeys(kinds("guidance", with_files=False), "guidance law")
    return names | dict.fromkeys(kinds("policy", with_files=False), "policy")


def _named(given: str) -> tuple[str, str]:
    """Return the name before "=" (empty without one) and the agent after it.

    A folder before "=" belongs to the path of a file.
    """
    name, equals, agent = given.partition("=")
    return (name, agent) if equals and "/" not in name else ("", given)


def label(agent: str) -> str:
    """Return the name of an agent for tables, from its file, name or ``module:Name``.

    ``NAME=`` before the agent sets its name. Otherwise files lose their folder and suffix, classes
    their module.

    Examples
    --------
    >>> label("out/ppo/model.zip"), label("my_package.agents:Careful"), label("wide=out/model.zip")
    ('model', 'Careful', 'wide')
    """
    name, agent = _named(agent)
    if name:
        return name
    if _is_file(agent):
        return Path(agent).stem
    return agent.rpartition(":")[2]


def _is_file(given: str) -> bool:
    return Path(given).suffix in (".npz", ".onnx", ".zip")


def check(agent: str, *, trust_pickle: bool = False) -> None:
    """Check that an agent exists and may be loaded, before an environment is made.

    `agent` is a name, a file or ``module:Name``; `trust_pickle` permits Stable-Baselines3 files.

    Raises
    ------
    InputError
        If the name or file does not exist, or the file is not permitted.
    """
    _, agent = _named(agent)
    if _is_file(agent):
        if not Path(agent).is_file():
            raise InputError("--agent", agent, "must be an existing file")
        if Path(agent).suffix == ".zip":
            check_trust(agent, trust_pickle)
    elif ":" not in agent and agent not in known_agents():
        near = suggestion(agent, known_agents())
        if not near.startswith("Did"):
            near = "`lunarsim evaluate --help` describes the agents."
        raise InputError(
            "--agent",
            agent,
            "must be the name of an agent, a file (.npz, .onnx, .zip) or module:Name",
            near,
        )


def agent_of(agent: str, env: gymnasium.Env[Any, Any], *, trust_pickle: bool = False) -> Agent:
    """Create an agent from a name, a file or ``module:Name``.

    Parameters
    ----------
    agent
        Name from `known_agents`, network file (``.npz``, ``.onnx``), Stable-Baselines3 file
        (``.zip``), or ``module:Name`` of a callable (`custom_agents.custom_agent`), a guidance law
        or a policy. ``NAME=`` before it sets its name in tables.
    env
        Environment to fly.
    trust_pickle
        Whether to read Stable-Baselines3 files, which can run any code when they are loaded.

    Raises
    ------
    InputError
        If there is no such agent, or it cannot fly this environment.
    """
    check(agent, trust_pickle=trust_pickle)
    _, agent = _named(agent)
    if _is_file(agent):
        path = Path(agent)
        if path.suffix == ".npz":
            return _network_agent(env, path, agent)
        if path.suffix == ".onnx":
            return OnnxAgent(env, path)
        return Sb3Agent(env, path, trust_pickle=trust_pickle)
    if ":" in agent:
        contract = contract_of_custom_part(agent)
        if contract is None:
            made: Agent = custom_agent(env, agent)
            return made
        allow_modules(agent.partition(":")[0])  # the user of the agent's name permits its module
        return GuidanceLawAgent(env, agent) if contract == "guidance" else PolicyAgent(env, agent)
    if agent in BUILT_IN:
        built: Agent = BUILT_IN[agent](env)
        return built
    if agent in packaged_agents():
        return _network_agent(env, packaged_agents()[agent], agent)
    return (
        GuidanceLawAgent(env, agent)
        if agent in kinds("guidance", with_files=False)
        else PolicyAgent(env, agent)
    )


def _network_agent(env: gymnasium.Env[Any, Any], path: Path, name: str) -> Agent:
    """Create the agent of a ``.npz`` file: a site network or a descent network."""
    if is_site_network(path):
        return SiteNetworkAgent(env, SiteNetwork.load(path), name)
    return NetworkAgent(env, Network.load(path), name)
