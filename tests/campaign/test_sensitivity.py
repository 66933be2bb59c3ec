"""Sensitivity against functions whose indices are known in closed form."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.campaign.dispersions import world_index
from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.flight_execution import build_plan
from lunarsim.campaign.plan import Work
from lunarsim.campaign.results import load_results
from lunarsim.campaign.run import run
from lunarsim.campaign.sensitivity import WORLD_FACTOR, sensitivities
from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.rng import flight_seed
from tests.worlds import TINY_FLIGHT

KEYS = ("start.position_m.0", "start.position_m.1", "start.position_m.2")
# The draws less these are uniform from -pi to pi.
MIDDLES = (-600.0, 0.0, 500.0)


def spec(method: str, flights: int, keys: int = 3, **more: object) -> CampaignSpec:
    laws = {
        key: {"kind": "uniform", "low": middle - np.pi, "high": middle + np.pi}
        for key, middle in list(zip(KEYS, MIDDLES, strict=True))[:keys]
    }
    given = {
        "name": "s", "flights": flights, "seed": 3, "scenario": TINY_FLIGHT, "method": method,
        "dispersions": laws,
    }  # fmt: skip
    return CampaignSpec.from_dict(given | more)


def ishigami(study, group, arm, memory):
    """Ishigami and Homma (1990) with a = 7, b = 0.1, and noise of the flight's own seed."""
    x = [group.draws[key] - middle for key, middle in zip(KEYS, MIDDLES, strict=True)]
    y = np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])
    seed = flight_seed(3, world_index(group.flight, study["block"]))
    y += study["sigma"] * np.random.default_rng(seed).normal()
    lost = group.flight in study["lost"]
    return {"y": float("nan") if lost else float(y), "safe": bool(y > 0.0)}


def flown(tmp_path, method: str, flights: int, sigma: float = 0.0, lost: tuple[int, ...] = ()):
    made = spec(method, flights)
    study = {"block": made.dispersions.block, "sigma": sigma, "lost": lost}
    work = Work("tests.campaign.test_sensitivity:ishigami", study)
    plan = replace(build_plan(made), work=work, columns={"y": "float", "safe": "bool"})
    run(plan, InlineEngine(), tmp_path / "c")
    return load_results(tmp_path / "c")


def test_sobol_indices_of_ishigami_and_of_noise(tmp_path):
    sigma = 2.0
    found = flown(tmp_path, "saltelli", 512 * 6, sigma, lost=(6 * 7 + 2,))
    (made,) = sensitivities(found, "y")
    assert made.method == "sobol" and made.names == (*KEYS, WORLD_FACTOR)
    assert (made.rows, made.left_out) == (511 * 6, 6)
    # Variances: of x1, x2, and of x1 with x3 (Ishigami and Homma); of the noise.
    v1 = 0.5 * (1.0 + 0.1 * np.pi**4 / 5.0) ** 2
    v2, v13 = 49.0 / 8.0, 0.1**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    total = v1 + v2 + v13 + sigma**2
    first = np.array([v1, v2, 0.0, sigma**2]) / total
    both = np.array([v1 + v13, v2, v13, sigma**2]) / total
    for label, truth in (("first order", first), ("total", both)):
        value, low, high = np.array(made.indices[label]).T
        assert np.all(np.abs(value - truth) < 0.06)
        assert np.all((low - 0.02 < truth) & (truth < high + 0.02))
        assert np.all(high - low > 0.01 * (truth > 0.0)) and np.all(high - low < 0.3)
    again = sensitivities(found, "y")[0]
    # Compared as text, because a NaN is not equal to itself.
    assert repr(again) == repr(replace(made, chance=again.chance))


def test_blocks_hold_two_points_and_their_mixtures():
    made = spec("saltelli", 4 * 5, keys=2)
    rows = [list(made.dispersions.draws(i).values()) for i in range(20)]
    for n in range(4):
        a, one, two, world, b = rows[5 * n : 5 * n + 5]
        assert one == [b[0], a[1]] and two == [a[0], b[1]] and world == a
        assert not set(a) & set(b)
        assert [world_index(5 * n + k, 5) for k in range(5)] == [2 * n] * 3 + [2 * n + 1] * 2
    assert len({tuple(row) for row in rows}) == 4 * 4


def test_flights_of_one_block_share_their_world(tmp_path):
    made = spec("saltelli", 10, keys=2)
    study = build_plan(made).work.study
    assert [world_index(i, study.block) for i in range(10)] == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3]
    assert build_plan(spec("sobol", 8, keys=2)).work.study.block == 0


def test_pawn_distinguishes_what_matters_from_chance(tmp_path):
    found = flown(tmp_path, "monte-carlo", 600)
    for metric in ("y", "safe"):
        (made,) = sensitivities(found, metric, resamples=40)
        values = np.array(made.indices["PAWN"])
        assert made.method == "pawn" and made.names == KEYS and made.rows == 600
        assert np.all(values[:, 1] <= values[:, 0]) and np.all(values[:, 0] <= values[:, 2])
        # x1 and x2 move the distribution; x3 has no mean effect, and next to none on the sign.
        assert values[0, 1] > made.chance and values[1, 1] > made.chance
    assert 0.0 < made.chance < values[1, 0]
    assert values[2, 0] < 0.5 * values[1, 0]


def first_key(study, group, arm, memory):
    """A number that the first key moves, in noise of the flight's own seed."""
    noise = np.random.default_rng(flight_seed(3, group.flight)).normal()
    return {"y": float(group.draws[KEYS[0]] + 600.0 + 0.3 * noise), "safe": noise > 0.0}


def test_pawn_of_a_choice_and_of_its_mirror_are_the_same(tmp_path):
    """Whether the rare value is the greater or the lesser one: it fills one tenth of ten."""
    found = []
    for name, weights in (("a", [0.5, 0.5]), ("b", [0.9, 0.1]), ("c", [0.1, 0.9])):
        laws = {KEYS[0]: {"kind": "choice", "values": [-601.0, -599.0], "weights": weights}}
        made = spec("monte-carlo", 400, dispersions=laws)
        work = Work("tests.campaign.test_sensitivity:first_key", None)
        plan = replace(build_plan(made), work=work, columns={"y": "float", "safe": "bool"})
        run(plan, InlineEngine(), tmp_path / name)
        (told,) = sensitivities(load_results(tmp_path / name), "y", resamples=20)
        found.append(told.indices["PAWN"][0][0])
    # Held at one of two values half of the flights are missed; at the common one a tenth.
    assert found[0] == pytest.approx(0.5, abs=0.06)
    assert found[1] == pytest.approx(0.1, abs=0.06) and found[2] == pytest.approx(0.1, abs=0.06)


def test_what_cannot_be_determined_is_reported(tmp_path, monkeypatch):
    found = flown(tmp_path, "monte-carlo", 20)
    (made,) = sensitivities(found, "y")
    assert made.indices == {} and "20 flights" in made.why_not
    with pytest.raises(InputError, match="z"):
        sensitivities(found, "z")
    done = CliRunner().invoke(main, ["campaign", "sensitivity", str(tmp_path / "c")])
    assert done.exit_code == 0 and "fewer than 50" in done.output
    monkeypatch.setitem(sys.modules, "SALib", None)
    done = CliRunner().invoke(main, ["campaign", "sensitivity", str(tmp_path / "c")])
    assert done.exit_code == 2 and 'pip install ".[sensitivity]"' in done.output


@pytest.mark.parametrize(
    ("more", "field", "says"),
    [
        ({"flights": 100}, "flights", "96 or 192"),
        ({"flights": 6}, "flights", "12 or 24"),
        ({"dispersions": {}}, "method", "monte-carlo"),
        ({"stop": {"metric": "safe", "width": 0.1}}, "stop", "monte-carlo"),
        (
            {"correlations": [{"keys": list(KEYS[:2]), "matrix": [[1.0, 0.5], [0.5, 1.0]]}]},
            "correlations",
            "independent keys",
        ),
    ],
    ids=str,
)
def test_bad_saltelli_designs_are_refused(more, field, says):
    with pytest.raises(InputError, match=says) as refused:
        spec("saltelli", **({"flights": 96} | more))
    assert refused.value.field == field


def test_what_chance_gives_is_the_quantile_that_is_said(tmp_path):
    """PAWN of columns drawn for nothing, worked out plainly: 95 % of them lie below."""
    found = flown(tmp_path, "monte-carlo", 200)
    (made,) = sensitivities(found, "y", 60)
    y = np.sort(found.table["y"].to_numpy())
    rng = np.random.default_rng(2)
    medians = []
    for _ in range(400):
        tenths = rng.permutation(200).reshape(10, 20)
        shares = np.arange(1, 201) / 200.0
        distances = [
            np.max(np.abs(np.searchsorted(np.sort(y[tenth]), y, "right") / 20.0 - shares))
            for tenth in tenths
        ]
        medians.append(np.median(distances))
    low, high = np.quantile(medians, (0.8, 1.0))
    assert low < made.chance < 1.1 * high
