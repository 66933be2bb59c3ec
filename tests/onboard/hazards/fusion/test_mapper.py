"""Test the fused mapper: which mappers it uses, and when it updates its map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.fused import FusedCalibration
from lunarsim.onboard.hazards.fusion import FusedMapper, FusedMapperSettings
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapperSettings
from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapperSettings
from lunarsim.onboard.hazards.shadows.mapping import ShadowMapping
from lunarsim.rocks.population import RockExpectation
from tests.made_mapper import GRID, TERMS, Made


def test_it_draws_when_another_has_drawn_and_only_then():
    own = Made()
    fused = FusedMapper({"own": own}, TERMS)
    assert fused.is_empty
    assert fused.source_mappers == {"own"}
    assert not fused.hazard_map().observed.any()
    assert fused.terrain_height(np.zeros(2)) is None
    own.update(0.7, None)
    for _ in range(3):
        assert (fused.hazard_map().p_safe == np.float32(0.7)).all()
    assert own.asked == 2
    own.update(0.4, None)
    assert (fused.hazard_map().p_safe == np.float32(0.4)).all()
    assert not fused.is_empty
    assert fused.terrain_height(np.zeros(2)) == 3.0
    assert fused.grid == GRID


def test_it_draws_no_oftener_than_it_is_set_to():
    own = Made()
    fused = FusedMapper({"own": own}, TERMS, interval=1.0)
    told = []
    for n, p in enumerate((None, 0.7, 0.4, 0.3, 0.2)):
        fused.refresh(0.5 * n)
        if p is not None:
            own.update(p, None)
        told.append(float(fused.hazard_map().p_safe[0, 0]))
    # An empty map is updated at once.
    assert told == pytest.approx([0.0, 0.7, 0.7, 0.3, 0.3])
    # Retracted observations and a moved grid cause an update at once.
    own.grid = Grid.centred((1.0, 0.0), 8.0, 0.5)
    assert fused.hazard_map().grid == own.grid
    own.update(0.1, None)
    assert fused.hazard_map().p_safe[0, 0] == np.float32(0.2)
    own.p, own.seen = np.zeros_like(own.p), False
    assert not fused.hazard_map().observed.any()
    for wrong in (-0.1, float("nan"), float("inf")):
        with pytest.raises(InputError, match="interval"):
            FusedMapper({"own": own}, TERMS, interval=wrong)


def test_without_a_time_it_draws_whenever_another_has():
    own = Made()
    fused = FusedMapper({"own": own}, TERMS, interval=1.0)
    for p in (0.7, 0.4, 0.3):
        own.update(p, None)
        assert fused.hazard_map().p_safe[0, 0] == np.float32(p)
    fused.refresh(0.5)
    own.update(0.2, None)
    assert fused.hazard_map().p_safe[0, 0] == np.float32(0.3)


def test_what_its_part_says_of_drawing_counts(tmp_path):
    c = FusedCalibration(0.2, 1.1, 0.4)
    c.save(tmp_path / "c.json")
    part = FusedMapperSettings(
        calibration_path=tmp_path / "c.json", calibration_mapper="tree", interval=3.0
    )
    parts = {"dem": GaussianDemMapperSettings(), "tree": QuadtreeMapperSettings(), "all": part}
    given = {"lander": Lander(), "rocks": RockExpectation()}
    briefing: Briefing = SimpleNamespace(software=SimpleNamespace(mappers=parts), **given)
    own = Made()
    made = part.build(briefing, None, {"dem": own, "tree": Made()})
    assert made.source_mappers == {"dem", "tree"}
    assert made.calibration == c
    own.update(0.7, None)
    made.refresh(0.0)
    first = made.hazard_map()
    for time, same in ((0.0, True), (2.9, True), (3.0, False)):
        own.update(0.4, None)
        made.refresh(time)
        assert (made.hazard_map() is first) == same, time


def test_the_worst_of_a_second_map_near_by_is_what_the_calibration_looks_at():
    own, second, c = Made(), Made(), FusedCalibration(0.2, 1.1, 0.4)
    own.update(0.7, None)
    second.grid, second.seen = Grid.centred((0.0, 0.0), 8.0, 0.25), True
    second.p = np.full(second.grid.shape, 0.9, np.float32)
    second.p[:, ::2] = 0.2
    second.observed = np.ones(second.grid.shape, bool)
    second.observed[:4] = False
    fused = FusedMapper({"own": own}, TERMS, c, {"tree": second})
    mine = np.full(1, 0.7, np.float32)
    seen, unseen = (
        c.probability(mine, np.array([q], np.float32), np.array([known]))[0]
        for q, known in ((0.2, True), (0.0, False))
    )
    assert seen != unseen
    told = fused.hazard_map().p_safe
    assert told[4:] == pytest.approx(seen)
    assert told[:2] == pytest.approx(unseen)


def test_the_height_that_a_mapper_expects_of_terrain_it_has_not_seen_is_none():
    class Expects(Made):
        def terrain_height(self, xy):
            return 5.0

    own = Expects()
    fused = FusedMapper({"own": own}, TERMS)
    assert fused.terrain_height(np.zeros(2)) is None
    own.update(0.7, None)
    assert fused.terrain_height(np.zeros(2)) == 5.0


class Lazy(Made):
    """Mapper whose elevations are available before their evaluation."""

    def __init__(self):
        super().__init__()
        self.drawn = None

    def update(self, measurement, estimate):
        super().update(measurement, estimate)
        own = super().hazard_map()
        self.drawn = SimpleNamespace(
            grid=GRID, observed=own.observed, elevation=own.elevation, variance=None
        )

    def terrain_surface(self):
        return self.drawn or super().surface()


def test_terrain_that_was_drawn_before_it_was_evaluated_is_another_when_it_is_drawn_again():
    own = Lazy()
    fused = FusedMapper({"own": own}, TERMS)
    for p in (0.7, 0.4):
        own.update(p, None)
        assert fused.hazard_map().p_safe[0, 0] == np.float32(p)
        asked = own.asked
        assert fused.hazard_map() is fused.hazard_map()
        assert own.asked == asked


def test_it_takes_no_measurement_and_is_made_of_something():
    with pytest.raises(InputError, match="measurement"):
        FusedMapper({"own": Made()}, TERMS).update(1.0, None)
    with pytest.raises(InputError, match="mappers: must not be empty"):
        FusedMapper({}, TERMS)


def test_left_out_it_is_made_of_all_that_publish():
    parts = {
        "dem": GaussianDemMapperSettings(),
        "eye": ShadowMapping(),
        "all": FusedMapperSettings(),
    }
    assert list(parts["all"].fused_mappers(parts)) == ["dem", "eye"]
    assert list(FusedMapperSettings(("eye",)).fused_mappers(parts)) == ["eye"]
    parts["mine"] = SimpleNamespace(sensor="flash")
    with pytest.raises(InputError, match="provide elevations or rocks"):
        FusedMapperSettings(("mine",)).fused_mappers(parts)


def test_it_is_built_of_those_that_were_built_before():
    parts = {"dem": GaussianDemMapperSettings(), "all": FusedMapperSettings(terrain_prior=0.7)}
    given = {"lander": Lander(), "rocks": RockExpectation()}
    briefing: Briefing = SimpleNamespace(software=SimpleNamespace(mappers=parts), **given)
    made = parts["all"].build(briefing, None, {"dem": Made(), "other": Made()})
    assert made.source_mappers == {"dem"}
    assert made.priors.terrain_prior == 0.7
    assert made.calibration is None
    with pytest.raises(InputError, match="terrain_prior"):
        FusedMapperSettings(terrain_prior=1.0)
