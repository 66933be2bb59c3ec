"""The public names: `import lunarsim` and `lunarsim.api`."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
import warnings

import numpy as np
import pytest
from click.testing import CliRunner

import lunarsim
import lunarsim.api
from lunarsim.cli import main
from lunarsim.scenario import Scenario
from tests.conftest import ROOT
from tests.worlds import TINY_FLIGHT

# Methods that a notebook calls to show an object.
NOTEBOOK = "_repr_{}_"


@pytest.mark.parametrize(("module", "stub"), [(lunarsim, "__init__"), (lunarsim.api, "api")])
def test_every_public_name_exists_is_documented_and_typed(module, stub):
    tree = ast.parse((ROOT / "lunarsim" / f"{stub}.pyi").read_text(encoding="utf-8"))
    typed = {
        (node.module, alias.name)
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert {name for _, name in typed} == set(module.__all__)
    for source, name in typed:
        assert getattr(importlib.import_module(source), name) is getattr(module, name)
    assert set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        assert getattr(module, name).__doc__, name
    with pytest.raises(AttributeError, match="has no attribute 'fyl'"):
        module.fyl  # noqa: B018


def test_there_are_at_most_sixty_public_names():
    assert len({*lunarsim.__all__, *lunarsim.api.__all__}) <= 60


def test_import_loads_neither_opengl_nor_numba():
    code = "import sys, lunarsim; print({'numba', 'numpy', 'moderngl'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    path = tmp_path_factory.mktemp("face") / "tiny.toml"
    Scenario.from_dict(TINY_FLIGHT).save(path)
    return path


@pytest.fixture(scope="module")
def flight(tiny):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return lunarsim.fly(tiny, policy="safest", seed=3, rocks={"cover": 0.02})


def test_a_flight_is_the_one_of_the_command_line(tiny, flight, tmp_path):
    words = ["fly", tiny, "--policy", "safest", "--seed", 3, "--set", "rocks.cover=0.02"]
    done = CliRunner().invoke(main, [*map(str, words), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert str(flight) in done.stdout
    again = lunarsim.Flight.load(tmp_path / "out")
    assert np.array_equal(again.positions, flight.positions)
    assert str(again) == str(flight)


def test_a_flight_in_words_has_outcome_propellant_divert_and_touchdown(flight):
    text = str(flight)
    assert text.startswith(("landed safely", "not safe: "))
    for word in (f"{flight.propellant_used:.1f} kg", "divert", "touchdown", "vertical speed"):
        assert word in text


def test_figures_of_a_flight_are_saved_and_shown_in_a_notebook(flight, tmp_path):
    figures = flight.plot()
    figures.save(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["descent.png", "maps.png", "touchdown.png"]
    html = getattr(figures, NOTEBOOK.format("html"))()
    assert html.count("data:image/png;base64,") == 3


def test_other_values_of_a_scenario_are_checked(tiny):
    with pytest.raises(lunarsim.InputError, match=r"rocks\.cover: .* got 0\.9"):
        lunarsim.fly(tiny, rocks={"cover": 0.9})
    with pytest.raises(lunarsim.InputError, match="got 'hirse'"):
        lunarsim.fly("hirse")
    with pytest.raises(lunarsim.InputError, match="got 'safst'"):
        lunarsim.fly(tiny, policy="safst")


def test_policies_are_compared_over_the_same_worlds(tiny):
    result = lunarsim.compare(tiny, ["no-divert", "safest"], flights=2, seed=3)
    assert [(row["flight"], row["policy"]) for row in result.rows] == [
        (0, "no-divert"), (0, "safest"), (1, "no-divert"), (1, "safest"),
    ]  # fmt: skip


def test_an_image_is_the_one_of_the_command_line(tiny, tmp_path):
    image = lunarsim.render(tiny, altitude=40.0, seed=2)
    image.save(tmp_path / "here.png")
    words = ["render", tiny, "--altitude", 40, "--seed", 2, "--out", tmp_path / "there.png"]
    done = CliRunner().invoke(main, [*map(str, words)])
    assert done.exit_code == 0, done.output
    assert image.description in done.stdout
    assert (tmp_path / "here.png").read_bytes() == (tmp_path / "there.png").read_bytes()
    assert getattr(image, NOTEBOOK.format("png"))() == (tmp_path / "here.png").read_bytes()


def test_types_of_scenario_tables_are_those_of_the_parts():
    command = [sys.executable, str(ROOT / "scripts" / "scenario_types.py")]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    stub = (ROOT / "lunarsim" / "scenario" / "tables.pyi").read_text(encoding="utf-8")
    assert ast.dump(ast.parse(printed)) == ast.dump(ast.parse(stub))
