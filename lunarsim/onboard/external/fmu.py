"""Connection to flight software in an FMU (functional mock-up unit).

The variables of the FMU have the names of the fields: ``time_to_go``, ``estimate.mass``, and for
vectors ``estimate.position[1]`` to ``estimate.position[3]``. An FMU of FMI 3.0 can also have an
array ``estimate.position``. It uses any of the inputs, and must have all outputs. FMI 2.0 and 3.0
are supported; the optional package FMPy runs the FMU.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.interface.definitions import ROLES
from lunarsim.interface.structs import Struct
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.typing import Array

# Roles of an FMU, and field of the briefing that is the period of its steps.
PERIODS = {"guidance": "cycle", "control": "step"}


def scalar_views(struct: Struct, prefix: str = "") -> dict[str, Any]:
    """Return views of all numbers of a message by the name of the variable.

    Arrays of variable size and texts are omitted.
    """
    found: dict[str, Any] = {}
    for f in struct.message.fields:
        name = prefix + f.name
        if f.count or f.type == "text":
            continue
        if f.is_message:
            found |= scalar_views(struct.parts[f.name], f"{name}.")
        elif not f.shape:
            found[name] = struct.buffer[f.name]
        else:
            flat = struct.flat[f.name]
            for k, index in enumerate(np.ndindex(*f.shape)):
                one_based = ",".join(str(i + 1) for i in index)
                found[f"{name}[{one_based}]"] = flat[k : k + 1]
            found[name] = flat
    return found


def _read(path: Path) -> tuple[Any, Any]:
    """Return the module `fmpy` and the description of an FMU.

    Raises
    ------
    InputError
        If FMPy is not installed, or the file is no FMU for co-simulation.
    """
    try:
        import fmpy  # noqa: PLC0415  (an optional package)
    except ModuleNotFoundError:
        raise InputError(
            "path", str(path), "needs the package FMPy, which is not installed",
            "Install the extra `fmi`.",
        ) from None  # fmt: skip
    try:
        description = fmpy.read_model_description(str(path))
    except Exception as error:  # fmpy raises many types on damaged files
        reason = " ".join(str(error).split())
        raise InputError("path", str(path), f"must be an FMU ({reason})") from None
    if description.coSimulation is None or not description.fmiVersion.startswith(("2", "3")):
        raise InputError("path", str(path), "must be an FMU for co-simulation, FMI 2.0 or 3.0")
    return fmpy, description


class FmuConnection:
    """Flight software of one role and one flight in an FMU.

    Parameters
    ----------
    path
        File of the FMU.
    role
        Name of the role: "guidance" or "control".
    briefing
        Briefing of the software; the FMU gets parameters with names of its numbers.

    Raises
    ------
    InputError
        If the FMU is unsuitable or cannot be started.
    """

    def __init__(self, path: Path, role: str, briefing: Struct) -> None:
        self.role = role
        if role not in PERIODS:
            raise InputError(
                "path", str(path), f"must be a shared library: an FMU cannot have the role {role}"
            )
        self._period, self._calls = float(briefing.get(PERIODS[role])), 0
        self._fmpy, description = _read(path)
        self._given: Struct | None = None
        self._views: tuple[dict[str, Any], dict[str, Any]] = {}, {}
        self._is_fmi2 = description.fmiVersion.startswith("2")
        variables = {v.name: v for v in description.modelVariables}
        self._inputs = [v for v in variables.values() if v.causality == "input"]
        known = scalar_views(Struct(ROLES[role].input))
        answers = scalar_views(Struct(ROLES[role].output))
        self._outputs = [v for v in variables.values() if v.name in answers]
        unknown = [v.name for v in self._inputs if v.name not in known]
        if unknown:
            raise InputError(
                "path", str(path), f"has the input {unknown[0]}, which role {role} does not have",
                f"Inputs: {', '.join(n for n in known if '[' not in n)}.",
            )  # fmt: skip
        names = {v.name.partition("[")[0] for v in self._outputs}
        missing = [f.name for f in Struct(ROLES[role].output).message.fields if f.name not in names]
        if missing:
            raise InputError("path", str(path), f"must have the output {missing[0]}")
        self._folder = self._fmpy.extract(str(path))
        try:
            self._unit = self._start(description, variables, scalar_views(briefing))
        except Exception as error:  # fmpy raises many types
            shutil.rmtree(self._folder, ignore_errors=True)
            raise InputError("path", str(path), f"must start ({error})") from None

    def _start(self, description: Any, variables: dict[str, Any], known: dict[str, Any]) -> Any:
        """Instantiate and initialise the FMU, with parameters from the briefing."""
        unit = self._fmpy.instantiate_fmu(self._folder, description, fmi_type="CoSimulation")
        parameters = [v for v in variables.values() if v.causality == "parameter"]
        self._set(unit, [v for v in parameters if v.name in known], known)
        if self._is_fmi2:
            unit.setupExperiment(startTime=0.0)
        unit.enterInitializationMode()
        unit.exitInitializationMode()
        return unit

    def _set(self, unit: Any, variables: list[Any], values: dict[str, Any]) -> None:
        for v in variables:
            numbers = values[v.name].astype(np.float64).tolist()
            setter = unit.setReal if self._is_fmi2 else unit.setFloat64
            setter([v.valueReference], numbers)

    def step(self, given: Struct, answer: Struct) -> None:
        """Set the inputs, advance the FMU by one period, and get the outputs.

        Raises
        ------
        SoftwareFailure
            If a call of the FMU fails.
        """
        if given is not self._given:
            self._given, self._views = given, (scalar_views(given), scalar_views(answer))
        inputs, outputs = self._views
        try:
            self._set(self._unit, self._inputs, inputs)
            self._unit.doStep(self._calls * self._period, self._period)
            for v in self._outputs:
                outputs[v.name][:] = self._get(v, outputs[v.name].size)
        except Exception as error:  # fmpy raises its own types
            raise SoftwareFailure(self.role, "error", str(error)) from None
        self._calls += 1

    def _get(self, variable: Any, count: int) -> Array:
        if self._is_fmi2:
            return np.asarray(self._unit.getReal([variable.valueReference]))
        return np.asarray(self._unit.getFloat64([variable.valueReference], nValues=count))

    def close(self) -> None:
        """End the FMU; further calls do nothing."""
        if self._folder:
            folder, self._folder = self._folder, ""
            self._unit.terminate()
            self._unit.freeInstance()
            shutil.rmtree(folder, ignore_errors=True)
