"""A guidance law in an FMU of FMI 2.0 or 3.0 flies as the same law in C."""

from __future__ import annotations

import re
import subprocess
import zipfile
from pathlib import Path

import pytest

from lunarsim import InputError
from lunarsim.interface import allow_programs
from lunarsim.simulation import Simulation
from tests.interface.software import assert_same_flight, compiler, library, small

fmpy = pytest.importorskip("fmpy")
SOURCE = Path(__file__).with_name("fmu.c")
INPUTS = {"estimate.position": 3, "estimate.velocity": 6, "end.position": 9, "end.velocity": 12}


@pytest.fixture(autouse=True)
def allowed(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_PROGRAMS", "")


def _variables(version: int, outputs: dict[str, int], extra: str) -> str:
    """Return the variables of the model description."""
    lines = []

    def add(name: str, reference: int, causality: str, size: int = 1) -> None:
        start = ' start="0"' if causality in ("input", "parameter") else ""
        kind = "fixed" if causality == "parameter" else "continuous"
        head = f'name="{name}" valueReference="{reference}" causality="{causality}"'
        if version == 2:
            lines.append(
                f'<ScalarVariable {head} variability="{kind}"><Real{start}/></ScalarVariable>'
            )
            return
        starts = f' start="{" ".join(["0"] * size)}"' if start else ""
        inside = f'<Dimension start="{size}"/>' if size > 1 else ""
        lines.append(f'<Float64 {head} variability="{kind}"{starts}>{inside}</Float64>')

    if version == 3:
        add("time", 99, "independent")
    add("gravity", 0, "parameter")
    add("lag", 1, "parameter")
    add("time_to_go", 2, "input")
    if extra:
        add(extra, 3, "input")
    for causality, vectors in (("input", INPUTS), ("output", outputs)):
        for name, first in vectors.items():
            if version == 3:
                add(name, first, causality, 3)
                continue
            for k in range(3):
                add(f"{name}[{k + 1}]", first + k, causality)
    return "".join(lines)


def made(folder: Path, version: int, output: str = "acceleration", extra: str = "") -> Path:
    """Compile and pack an FMU."""
    code = Path(fmpy.__file__).parent / "c-code"
    binary, stubs = folder / "law.so", folder / "stubs.c"
    # An FMU exports all functions of the standard; the law defines those that it needs.
    functions = (code / f"fmi{version}Functions.h").read_text()
    names = set(re.findall(rf"TYPE\s+(fmi{version}\w+)\s*;", functions))
    unused = sorted(names - set(re.findall(rf"\b(fmi{version}\w+)\(", SOURCE.read_text())))
    assert len(unused) > 10
    stubs.write_text("\n".join(f"int {name}(void) {{ return 3; }}" for name in unused))
    subprocess.run(
        [compiler("gcc"), "-O2", "-Wall", "-ffp-contract=off", "-shared", "-fPIC", f"-I{code}",
         *(["-DFMI3"] if version == 3 else []), SOURCE, stubs, "-o", binary, "-lm"], check=True,
    )  # fmt: skip
    variables = _variables(version, {output: 15}, extra)
    count = variables.count('causality="output"')
    if version == 2:
        first = variables.count("<ScalarVariable") - count + 1
        unknowns = "".join(f'<Unknown index="{first + k}"/>' for k in range(count))
        description = (
            '<fmiModelDescription fmiVersion="2.0" modelName="law" guid="{1}">'
            '<CoSimulation modelIdentifier="law"/>'
            f"<ModelVariables>{variables}</ModelVariables><ModelStructure><Outputs>{unknowns}"
            "</Outputs></ModelStructure></fmiModelDescription>"
        )
    else:
        description = (
            '<fmiModelDescription fmiVersion="3.0" modelName="law" instantiationToken="{1}">'
            '<CoSimulation modelIdentifier="law"/>'
            f"<ModelVariables>{variables}</ModelVariables><ModelStructure>"
            '<Output valueReference="15"/></ModelStructure></fmiModelDescription>'
        )
    path = folder / f"law{version}.fmu"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("modelDescription.xml", '<?xml version="1.0"?>' + description)
        file.write(binary, f"binaries/{'linux64' if version == 2 else 'x86_64-linux'}/law.so")
    allow_programs(path)
    return path


@pytest.mark.parametrize("version", [2, 3])
def test_fmu_flies_as_the_library(version, tmp_path):
    path = library("e_guidance.c")
    allow_programs(path)
    known = {"kind": "library", "path": str(path), "isolated": False}
    expected = Simulation(small(guidance=known), 4, "safest").run()
    fmu = {"kind": "fmu", "path": str(made(tmp_path, version)), "isolated": version == 2}
    assert_same_flight(expected, Simulation(small(guidance=fmu), 4, "safest").run())


@pytest.mark.parametrize("isolated", [True, False])
def test_unsuitable_fmu_is_an_input_error(isolated, tmp_path):
    def error(path: Path, table: str = "guidance") -> str:
        given = {"kind": "fmu", "path": str(path), "isolated": isolated}
        with pytest.raises(InputError) as caught:
            Simulation(small(**{table: given}), 1)
        assert caught.value.field.startswith(f"{table}.")
        return str(caught.value)

    assert "must have the output acceleration" in error(made(tmp_path, 2, output="thrust"))
    assert "has the input altitude" in error(made(tmp_path, 2, extra="altitude"))
    law = made(tmp_path, 2)
    assert "has the input time_to_go" in error(law, "control")
    text = tmp_path / "text.fmu"
    text.write_text("no archive")
    allow_programs(text)
    assert "must be an FMU" in error(text)
