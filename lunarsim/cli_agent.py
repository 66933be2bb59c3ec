"""Define the commands `lunarsim agent ...`."""

from __future__ import annotations

from pathlib import Path

import click

from lunarsim.cli_common import PATH, ErrorReportingGroup
from lunarsim.errors import check_output


@click.group(cls=ErrorReportingGroup)
def agent() -> None:
    """Export trained agents."""


@agent.command()
@click.argument("agent", type=PATH)
@click.option("--out", type=PATH, required=True, help="ONNX file to write (.onnx).")
@click.option(
    "--vec-normalize", type=PATH, default=None,
    help="File of VecNormalize.save, if the training normalised its observations. Default: it did "
    "not.",
)  # fmt: skip
@click.option(
    "--trust-pickle", is_flag=True,
    help="Allow AGENT and the file of VecNormalize. They contain Python pickles, which can run any "
    "code when they are loaded.",
)  # fmt: skip
def export(agent: Path, out: Path, vec_normalize: Path | None, trust_pickle: bool) -> None:
    """Write the policy of a Stable-Baselines3 AGENT (.zip) to an ONNX file.

    An ONNX file contains no code, and `lunarsim evaluate` flies it without Stable-Baselines3. The
    command needs the extra `rl`.

    \b
    Example:
      lunarsim agent export out/ppo/checkpoint/model.zip --out ppo.onnx --trust-pickle
    """  # noqa: D301  (click wants the character itself)
    from lunarsim_envs.agents.onnx_export import export_onnx

    check_output("--out", out, ".onnx")
    export_onnx(agent, out, vec_normalize=vec_normalize, trust_pickle=trust_pickle)
    click.echo(f"written: {out}")
