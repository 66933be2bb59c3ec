from __future__ import annotations

from lunarsim.rng import RandomStreams, flight_seed


def test_streams_depend_on_name_and_seed_alone():
    a = RandomStreams(flight_seed(1, 4))
    b = RandomStreams(flight_seed(1, 4))
    b.get("other")
    assert a.get("lidar").random() == b.get("lidar").random()
    assert a.get("lidar").random() != a.get("rocks").random()
    assert a.get("lidar").random() != RandomStreams(flight_seed(1, 5)).get("lidar").random()
    assert a.get("lidar").random() != RandomStreams(flight_seed(2, 4)).get("lidar").random()
