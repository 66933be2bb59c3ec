"""The chase view and the onboard camera of `Retarget-v1`."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.chase_view import HEIGHT, PANEL, WIDTH, ChaseViewRenderer, project

ID = "lunarsim_envs:lunarsim/Retarget-v1"


@pytest.fixture(scope="module")
def env():
    env = gymnasium.make(ID, perception="onboard", render_mode="rgb_array", views=True)
    env.reset(seed=1)
    yield env
    env.close()


def test_views_stand_above_the_rest(env):
    frame, plain = env.render(), env.unwrapped.frames
    assert frame.shape == (720, 800, 3)
    assert np.array_equal(frame[HEIGHT:], plain.draw(env.unwrapped.seen, None, None))
    assert frame[:HEIGHT, :WIDTH].std() > 10.0


def test_the_lander_is_in_the_middle_and_the_site_in_sight(env):
    views = env.unwrapped.views
    s, view = views.simulation, views.chase()
    lander, site = project(view, np.array([s.state.position, s.true_to_local.to_site(s.site)]))
    assert lander == pytest.approx((0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)), abs=1.0)
    assert (site >= 0).all() and (site < (WIDTH, HEIGHT)).all()
    # Upright: what is over the lander is above it in the picture.
    over = project(view, s.state.position[None] + [0.0, 0.0, 1.0])[0]
    assert over[1] < lander[1]


def test_the_terrain_is_rendered_as_the_sensor_meets_it(env):
    """Where a ray of the chase view meets the ground it is lit; the sky is dark."""
    views = env.unwrapped.views
    view = views.chase()
    seen = views.seen_by(view)
    s = views.simulation
    site = project(view, s.true_to_local.to_site(s.site)[None])[0]
    patch = seen[site[1] - 8 : site[1] + 9, site[0] - 8 : site[0] + 9, 0]
    assert patch.mean() > 60
    assert 60 < np.percentile(patch, 90) < 236


def test_gauges_move_with_their_values(env):
    views = env.unwrapped.views
    before = views.gauges()
    assert before.shape == (HEIGHT - PANEL, PANEL, 3)
    env.step(0)
    assert not np.array_equal(before, views.gauges())


def test_closing_lets_go_of_the_flight_and_resetting_takes_up_again(env):
    inner = env.unwrapped
    inner.close()
    assert inner.simulation is None and inner.views is None and inner.frames is None
    with pytest.raises(gymnasium.error.ResetNeeded):
        inner.render()
    env.reset(seed=1)
    assert isinstance(inner.views, ChaseViewRenderer)
    assert inner.render().shape == (720, 800, 3)


@pytest.mark.parametrize("more", [{}, {"render_mode": "rgb_array", "perception": "truth"}])
def test_views_of_nothing_are_refused(more):
    with pytest.raises(InputError, match="views"):
        gymnasium.make(ID, **({"perception": "onboard", "views": True} | more))
