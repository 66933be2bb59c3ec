"""Faults of sensors and actuators that Retarget-v1 draws for each episode."""

from __future__ import annotations

import gymnasium
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from gymnasium.utils.env_checker import check_env

from lunarsim.campaign.spec import CampaignSpec
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv
from lunarsim_envs.retarget import RetargetEnv, default_scenario
from tests.worlds import TINY_FLIGHT

ID = "lunarsim_envs:lunarsim/Retarget-v1"
FAULTY = Scenario.from_dict(TINY_FLIGHT).changed(
    sensor_faults={"high": {"kind": "bias", "sensor": "fix", "size": 0.0}},
    faults={"engine_loss_from_s": 5.0, "engine_loss": 0.1},
)
SIZE, START, OCCURS, LOSS, LOSS_FROM = (
    "sensor_faults.high.size", "sensor_faults.high.start_s", "sensor_faults.high.occurs",
    "faults.engine_loss", "faults.engine_loss_from_s",
)  # fmt: skip
FAULTS = {
    SIZE: {"kind": "uniform", "low": -4.0, "high": 4.0},
    START: {"kind": "uniform", "low": 0.5, "high": 3.0},
    OCCURS: {"kind": "choice", "values": [True, False]},
    LOSS: {"kind": "uniform", "low": 0.01, "high": 0.05},
    LOSS_FROM: {"kind": "uniform", "low": 1.0, "high": 3.0},
}
ALWAYS = {key: law for key, law in FAULTS.items() if key != OCCURS}
BIAS = {"kind": "bias", "sensor": "altimeter", "size": 1.0}


def golombek(**changes):
    """Return the default scenario with changes."""
    return default_scenario().changed(**changes)


def env_with(dispersions=None, **more):
    return RetargetEnv(FAULTY, perception="onboard", dispersions=dispersions or ALWAYS, **more)


def first_decision(env, seed):
    """Return the observation of the first decision as bytes, and the drawn values."""
    seen, info = env.reset(seed=seed)
    return b"".join(part.tobytes() for part in seen.values()), info["dispersions"]


def fault_events(env):
    """Return times of the started faults by name."""
    events = env.simulation.flight().events
    return {e["fault"]: e["time"] for e in events if e["name"] == "fault-started"}


def test_episodes_have_different_faults_and_a_seed_has_the_same_bits():
    env = env_with()
    seen, drawn = first_decision(env, 1)
    assert set(drawn) == set(ALWAYS)
    assert fault_events(env) == pytest.approx({"high": drawn[START], "engine": drawn[LOSS_FROM]})
    fault = env.simulation.scenario.sensor_faults["high"].make()
    assert (fault.size, fault.start) == (drawn[SIZE], drawn[START])
    assert env.simulation.scenario.faults.make().engine_loss == drawn[LOSS]
    other, different = first_decision(env, 2)
    assert other != seen and all(drawn[key] != different[key] for key in drawn)
    # The next episode without a seed draws again.
    _, third = first_decision(env, None)
    assert third[SIZE] not in (drawn[SIZE], different[SIZE])
    assert first_decision(env_with(), 1) == (seen, drawn)


def test_the_drawn_fault_acts_on_the_sensor():
    """The same episode without the fault has another estimate."""
    large = {SIZE: {"kind": "uniform", "low": 50.0, "high": 51.0}}
    kept, lost = (
        {OCCURS: {"kind": "choice", "values": [True, False], "weights": weights}}
        for weights in ([1.0, 0.0], [0.0, 1.0])
    )
    errors = {}
    for name, occurs in (("with", kept), ("without", lost)):
        env = env_with(large | occurs)
        env.reset(seed=3)
        errors[name] = np.linalg.norm(env.simulation.site_error)
        assert ("high" in fault_events(env)) == (name == "with")
    assert errors["with"] > 30.0 > 10.0 > errors["without"]


def test_a_fault_that_does_not_occur_is_a_flight_without_it():
    absent = FAULTY.changed(
        sensor_faults={"high": {"size": 50.0, "occurs": False}},
        faults={"engine_loss": 0.9, "occurs": False},
        simulation={"max_time_s": 8.0},
    )
    found = Simulation(absent, 4, "no-divert").run()
    plain = Scenario.from_dict(TINY_FLIGHT).changed(simulation={"max_time_s": 8.0})
    expected = Simulation(plain, 4, "no-divert").run()
    for name, column in expected.trajectory.items():
        assert np.array_equal(found.trajectory[name], column), name
    assert not any(event["name"] == "fault-started" for event in found.events)


def test_an_episode_draws_as_a_campaign_does_from_the_same_seed():
    env = env_with(FAULTS)
    _, info = env.reset(seed=5)
    flown = env.simulation
    spec = CampaignSpec.from_dict(
        {"name": "c", "flights": 2, "scenario": FAULTY.to_dict(), "dispersions": FAULTS,
         "factors": {"policy": ["no-divert"]}},
    )  # fmt: skip
    assert spec.dispersions.draws_of(flown.streams) == info["dispersions"]


def test_environments_of_a_vector_are_single_environments():
    vector = gymnasium.make_vec(
        ID, num_envs=2, vectorization_mode="sync", scenario=FAULTY, perception="onboard",
        dispersions=FAULTS,
    )  # fmt: skip
    seen, info = vector.reset(seed=7)
    for lane in range(2):
        alone, own = env_with(FAULTS).reset(seed=7 + lane)
        for name, part in alone.items():
            assert np.array_equal(seen[name][lane], part)
        for key, value in own["dispersions"].items():
            assert info["dispersions"][key][lane] == value
    vector.close()


def test_presence_of_faults_is_drawn_with_its_weights():
    env = env_with(FAULTS)
    found = set()
    for seed in range(8):
        _, info = env.reset(seed=seed)
        found.add(info["dispersions"][OCCURS])
        assert ("high" in fault_events(env)) == info["dispersions"][OCCURS]
    assert found == {True, False}


def test_propellant_of_an_episode_counts_from_its_own_full_lander():
    env = env_with({"truth.vehicle.dry_mass_scale": {"kind": "uniform", "low": 1.02, "high": 1.05}})
    env.reset(seed=1)
    start, over = env.simulation.lander.wet_mass, False
    while not over:
        *_, over, _, info = env.step(0)
    assert info["propellant_kg"] == pytest.approx(start - env.simulation.state.mass)
    assert 0.0 < info["propellant_kg"] == pytest.approx(env.simulation.flight().propellant_used)


def test_a_campaign_file_gives_the_same_dispersions(tmp_path):
    path = tmp_path / "campaign.toml"
    path.write_text(
        'name = "c"\nflights = 4\nscenario = "x.toml"\n[dispersions]\n'
        f'"{SIZE}" = {{ kind = "uniform", low = -4.0, high = 4.0 }}\n'
        f'"{START}" = {{ kind = "uniform", low = 0.5, high = 3.0 }}\n'
        f'[[correlations]]\nkeys = ["{SIZE}", "{START}"]\nmatrix = [[1.0, 0.9], [0.9, 1.0]]\n'
    )
    env = env_with(path)
    drawn = np.array([[d[SIZE], d[START]] for d in (first_decision(env, k)[1] for k in range(5))])
    assert np.corrcoef(drawn.T)[0, 1] > 0.5
    path.write_text('name = "c"\n')
    with pytest.raises(InputError, match="at least one scenario key"):
        env_with(path)


def test_an_evaluation_with_a_campaign_file_has_a_column_per_drawn_value(tmp_path):
    (tmp_path / "scenario.toml").write_text(FAULTY.to_toml())
    (tmp_path / "campaign.toml").write_text(
        f'[dispersions]\n"{SIZE}" = {{ kind = "uniform", low = -4.0, high = 4.0 }}\n'
        f'"{OCCURS}" = {{ kind = "choice", values = [true, false] }}\n'
    )
    given = ["--perception", "onboard", "--scenario", str(tmp_path / "scenario.toml"),
             "--dispersions", str(tmp_path / "campaign.toml")]  # fmt: skip
    end = ["--agent", "zero", "--episodes", "3", "--jobs", "1", "--out", str(tmp_path / "out")]
    ran = CliRunner().invoke(main, ["evaluate", "Retarget-v1", *given, *end])
    assert ran.exit_code == 0, ran.output
    table = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert table[SIZE].nunique() == 3 and table[OCCURS].dtype == bool
    ran = CliRunner().invoke(main, ["evaluate", "Guidance-v1", *given[4:], "--agent", "zero"])
    assert "applies only to Retarget-v1" in ran.output


def test_the_environment_keeps_the_interface_of_gymnasium():
    check_env(gymnasium.make(ID, scenario=FAULTY, perception="onboard", dispersions=FAULTS)
              .unwrapped, skip_render_check=True)  # fmt: skip


@pytest.mark.parametrize(
    ("dispersions", "field"),
    [
        ({"sensor_faults.hihg.size": FAULTS[SIZE]}, "dispersions.sensor_faults"),
        ({SIZE: {"kind": "uniform", "low": 2.0, "high": 1.0}}, f"dispersions.{SIZE}.low"),
        ({START: {"kind": "uniform", "low": -2.0, "high": 1.0}}, f"dispersions.{START}"),
        ({SIZE: FAULTS[SIZE], "sensor_faults.high": FAULTS[SIZE]}, "dispersions.sensor_faults"),
        ({SIZE: 3.0}, f"dispersions.{SIZE}"),
        ({"site_reward.safe": FAULTS[SIZE]}, "dispersions.site_reward.safe"),
        ({"domain_randomization.payload_kg": FAULTS[SIZE]}, "dispersions.domain_randomization"),
        ({"policy": {"kind": "choice", "values": ["safest", "no-divert"]}}, "dispersions.policy"),
        ({}, "dispersions"),
        ("missing.toml", "dispersions"),
        (3, "dispersions"),
    ],
)
def test_invalid_dispersions_are_refused_before_an_episode(dispersions, field):
    with pytest.raises(InputError) as caught:
        RetargetEnv(FAULTY, perception="onboard", dispersions=dispersions)
    assert caught.value.field.startswith(field)


def test_an_option_of_reset_that_is_drawn_is_refused():
    env = env_with({"rocks.cover": {"kind": "uniform", "low": 0.01, "high": 0.02}})
    with pytest.raises(InputError, match=r"options\.cover: must be omitted, because dispersions"):
        env.reset(seed=1, options={"cover": 0.05})
    env = env_with({"start.velocity_m_s.2": {"kind": "uniform", "low": -10.0, "high": -9.0}})
    with pytest.raises(InputError, match=r"options\.velocity_m_s: must be omitted"):
        env.reset(seed=1, options={"velocity_m_s": [8.0, 0.0, -9.0]})


def test_options_of_reset_and_drawn_values_act_together():
    env = env_with()
    _, info = env.reset(seed=1, options={"cover": 0.02})
    assert env.simulation.scenario.rocks.cover == 0.02
    assert env.simulation.scenario.sensor_faults["high"].make().size == info["dispersions"][SIZE]


@pytest.mark.parametrize(
    "make",
    [
        lambda **given: RetargetEnv(perception="surrogate", **given),
        lambda **given: RetargetEnv(perception="truth", **given),
        lambda **given: gymnasium.make_vec(
            ID, num_envs=2, vectorization_mode="vector_entry_point", **given
        ),
        GuidanceEnv,
        ControlEnv,
        lambda **given: gymnasium.make_vec(
            "lunarsim_envs:lunarsim/Guidance-v1", num_envs=2,
            vectorization_mode="vector_entry_point", **given,
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"dispersions": {SIZE: FAULTS[SIZE]}}, "dispersions"),
        ({"scenario": golombek(sensor_faults={"a": BIAS})}, "sensor_faults"),
        ({"scenario": golombek(faults={"engine_loss_from_s": 5.0})}, "faults"),
    ],
)
def test_kernels_refuse_faults_with_a_remedy(make, given, field):
    with pytest.raises(InputError) as caught:
        make(**given)
    assert caught.value.field == field
    assert "Retarget-v1 with perception='onboard'" in str(caught.value)
