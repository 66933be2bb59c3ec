from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander

G = 1.622


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"dry_mass": 0.0}, "dry_mass"),
        ({"thrust_min": 7000.0}, "thrust_min"),
        ({"legs": 5}, "legs"),
        ({"inertia_dry": (1.0, 1.0, 9.0)}, "inertia_dry"),
        ({"pad_diameter": 3.0}, "pad_diameter"),
        ({"slope_limit": 1.2}, "slope_limit"),
        ({"thrust_lag": -1.0}, "thrust_lag"),
        ({"leg_radius": "2"}, "leg_radius"),
        ({"legs": "4"}, "legs"),
    ],
)
def test_impossible_landers(change, field):
    with pytest.raises(InputError) as caught:
        Lander(**change)
    assert caught.value.field == f"vehicle.{field}"


def test_lander_must_hover():
    with pytest.raises(InputError, match="cannot hover"):
        Lander(thrust_max=2000.0).check_hover(G)
    with pytest.raises(InputError, match="cannot descend"):
        Lander(thrust_min=3000.0).check_hover(G)
    # 1100 kg and a reserve of 800 kg weigh 3082 N.
    Lander(thrust_min=3000.0, propellant_mass=900.0).check_hover(G, 800.0)
