"""Films: frames, their times, instruments, and the file as OpenCV reads it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image, ImageSequence
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.view import film as film_module
from lunarsim.view import save_film
from lunarsim.view.drawing import project
from lunarsim.view.film import HEIGHT, PANEL, WIDTH, FilmRenderer, frame_times
from lunarsim.view.moments import FlightMoments


@pytest.fixture(scope="module")
def renderer(flown):
    return FilmRenderer(flown.flight, flown.world)


@pytest.fixture(scope="module")
def film(flown, tmp_path_factory):
    """Return frames, frame rate and calls of progress of a film of 2 s."""
    path, calls = tmp_path_factory.mktemp("film") / "film.mp4", []
    save_film(flown.flight, path, seconds=2.0, world=flown.world, progress=calls.append)
    source, frames = cv2.VideoCapture(str(path)), []
    while (read := source.read())[0]:
        frames.append(read[1][..., ::-1])
    return np.array(frames), source.get(cv2.CAP_PROP_FPS), calls


def test_a_film_has_the_requested_duration(film):
    frames, rate, calls = film
    assert len(frames) / rate == pytest.approx(2.0)
    assert frames.shape[1:] == (HEIGHT, WIDTH + PANEL, 3)
    assert calls == [1] * len(frames)


def test_frames_follow_the_time_of_the_flight(film, renderer, flown):
    frames, _, _ = film
    times = frame_times(len(frames), flown.flight.duration)
    assert times[0] == 0.0 and times[-1] == flown.flight.duration
    assert np.diff(times)[:30] == pytest.approx(flown.flight.duration / 37, rel=1e-6)
    assert (times >= flown.flight.duration).sum() == 3  # 5 % of the film
    for k in (8, 20, 30):
        expected = renderer.frame(times[k])[:, :WIDTH].astype(float)
        off = [np.abs(frames[j, :, :WIDTH] - expected).mean() for j in range(k - 2, k + 3)]
        assert np.argmin(off) == 2


def test_the_same_flight_gives_the_same_frames(renderer, flown):
    again = FilmRenderer(flown.flight, flown.world)
    for time in (0.0, 0.5 * flown.flight.duration, flown.flight.duration):
        assert np.array_equal(renderer.frame(time), again.frame(time))


def test_states_are_those_of_the_record_and_smooth_between(flown):
    t = flown.flight.trajectory
    moments = FlightMoments(flown.flight)
    for row in (0, 17, 40, len(t["time"]) - 1):
        m = moments.at(t["time"][row])
        assert m.position == pytest.approx(flown.flight.positions[row])
        assert m.velocity == pytest.approx([t[f"velocity_{a}"][row] for a in "xyz"])
        q = np.array([t[f"attitude_{a}"][row] for a in "xyzw"])
        assert abs(m.attitude @ q) == pytest.approx(1.0)
        assert (m.mass, m.thrust) == pytest.approx((t["mass"][row], t["thrust"][row]))
    start, half = t["time"][40], 0.5 * (t["time"][40] + t["time"][41])
    moved = moments.at(half).position - moments.at(start).position
    mean = 0.5 * (moments.at(half).velocity + moments.at(start).velocity)
    assert moved == pytest.approx((half - start) * mean, abs=1e-3)
    assert moments.at(1e9).position == pytest.approx(flown.flight.positions[-1])
    assert not moments.at(1e9).is_flying and moments.at(start).is_flying


def test_chase_view_shows_lander_and_true_site(renderer, flown):
    moment = renderer.moments.at(flown.flight.duration)
    chase = renderer.chase
    view = chase.camera(moment)
    lander, site = project(view, np.array([moment.position, moment.site]))
    assert lander == pytest.approx((0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)), abs=1.0)
    ground = flown.world.terrain.elevation(moment.site[:2])
    assert moment.site[2] == pytest.approx(ground, abs=0.5)
    assert 0 <= site[0] < WIDTH and 0 <= site[1] < HEIGHT and site[1] >= lander[1]


def test_map_panel_shows_p_safe_with_north_up(renderer, flown):
    m = flown.flight.maps["dem"].hazard_map
    first = flown.flight.first_map.time
    assert renderer.map_panel(first - 0.5)[: PANEL - 24].max() <= 10
    panel = renderer.map_panel(first + 0.5).astype(int)
    scale = PANEL / m.grid.rows
    viridis = mpl.colormaps["viridis"]
    agree = []
    for row in range(6, m.grid.rows - 8, 5):
        for col in range(6, m.grid.cols - 3, 5):
            y, x = int((m.grid.rows - row - 0.5) * scale), int((col + 0.5) * scale)
            rgb = 255 * np.array(viridis(m.p_safe[row, col])[:3])
            expected = rgb if m.observed[row, col] else np.full(3, 128.0)
            agree.append(np.abs(panel[y, x] - expected).max() < 12)
    assert np.mean(agree) > 0.93  # site and lander hide a few cells


def test_instruments_change_with_their_values(renderer, flown):
    half = 0.5 * flown.flight.duration
    moment = renderer.moments.at(half)
    plain = renderer.instruments(half, moment)
    assert plain.shape == (HEIGHT - PANEL, PANEL, 3)
    for change in (
        {"position": moment.position + [0, 0, 5.0]}, {"velocity": moment.velocity + [3.0, 0, 0]},
        {"mass": moment.mass - 20.0}, {"thrust": 0.5 * moment.thrust},
        {"attitude": np.array([0.3, 0.0, 0.0, 0.95])},
    ):  # fmt: skip
        assert not np.array_equal(plain, renderer.instruments(half, moment._replace(**change)))


def test_instruments_show_the_true_state(renderer, flown, monkeypatch):
    """Names, values and bars, computed from a state with components that all differ."""
    shown = []
    monkeypatch.setattr(film_module, "draw_gauges", lambda rows, *_: shown.append(rows))
    lander = flown.lander
    site = np.array([3.0, -4.0, flown.world.terrain.elevation([3.0, -4.0])])
    moment = renderer.moments.at(0.0)._replace(
        position=site + [6.0, 8.0, 50.0 + lander.com_height], velocity=np.array([3.0, -4.0, -7.0]),
        attitude=Rotation.from_euler("yz", [18.0, 70.0], degrees=True).as_quat(), site=site,
        mass=lander.dry_mass + 0.25 * lander.propellant_mass, thrust=0.5 * lander.thrust_max,
    )  # fmt: skip
    renderer.instruments(0.5 * flown.flight.duration, moment)
    ((*rows,),) = shown
    values = {name: (text, share) for name, text, share in rows}
    left, thrust = 0.25 * lander.propellant_mass, 0.5 * lander.thrust_max
    assert {name: text for name, (text, _) in values.items()} == {
        "time": f"{0.5 * flown.flight.duration:.1f} s", "altitude": "50.0 m",
        "distance to site": "10.0 m", "descent rate": "7.0 m/s", "horizontal speed": "5.0 m/s",
        "tilt": "18.0 deg", "thrust": f"{thrust:.0f} N", "propellant": f"{left:.0f} kg",
    }  # fmt: skip
    bars = {name: share for name, (_, share) in values.items() if share is not None}
    assert bars == pytest.approx({"time": 0.5, "tilt": 0.2, "thrust": 0.5, "propellant": 0.25})


def test_the_caption_has_time_and_phase(renderer, flown, monkeypatch):
    texts = []
    monkeypatch.setattr(film_module, "draw_text", lambda _image, text, *_: texts.append(text))
    phases = flown.flight.trajectory["phase"]
    names = {0: "approach", 1: "vertical descent", 2: "abort", 3: "braking", 4: "hover"}
    for phase in np.unique(phases):
        time = float(flown.flight.trajectory["time"][np.flatnonzero(phases == phase)[1]])
        renderer.frame(time + 0.01)
        assert f"t = {time + 0.01:.1f} s, {names[int(phase)]}" in texts
    for phase, name in names.items():
        everywhere = {**flown.flight.trajectory, "phase": np.full_like(phases, phase)}
        changed = FilmRenderer(replace(flown.flight, trajectory=everywhere), flown.world)
        changed.frame(5.0)
        assert f"t = 5.0 s, {name}" in texts


def test_a_row_is_the_last_one_at_or_before_a_time(flown):
    moments, time = FlightMoments(flown.flight), flown.flight.trajectory["time"]
    assert [moments.row(time[k]) for k in (0, 1, 20)] == [0, 1, 20]
    assert moments.row(0.5 * (time[20] + time[21])) == 20
    assert (moments.row(-1.0), moments.row(1e9)) == (0, len(time) - 1)


def test_an_mp4_has_the_colours_of_the_frames(film, renderer, flown):
    """The panel, which has colours, agrees within the errors of the compression."""
    frames, _, _ = film
    found = frames[-1, :PANEL, WIDTH:].astype(float)
    expected = renderer.frame(flown.flight.duration)[:PANEL, WIDTH:].astype(float)
    swapped = np.abs(found - expected[..., ::-1]).mean()
    assert np.abs(found - expected).mean() < 8.0 < 0.5 * swapped


def test_a_gif_has_half_the_size_and_the_requested_duration(flown, tmp_path):
    path = save_film(flown.flight, tmp_path / "film.gif", seconds=1.0, world=flown.world)
    with Image.open(path) as image:
        times = [frame.info["duration"] for frame in ImageSequence.Iterator(image)]
    assert sum(times) == pytest.approx(1000.0)
    source = cv2.VideoCapture(str(path))
    assert source.get(cv2.CAP_PROP_FRAME_WIDTH) == (WIDTH + PANEL) // 2


def test_a_flight_of_one_row_without_maps_is_filmed(flown):
    f = flown.flight
    short = replace(
        f, maps={}, first_map=None, decisions=[], images={}, navigation={}, commands={},
        trajectory={name: values[:1] for name, values in f.trajectory.items()},
    )  # fmt: skip
    frame = FilmRenderer(short, flown.world).frame(0.0)
    assert frame.shape == (HEIGHT, WIDTH + PANEL, 3)


@pytest.mark.parametrize(
    ("name", "seconds", "field"), [("film.avi", 2.0, "path"), ("film.mp4", 0.1, "seconds")]
)
def test_wrong_arguments_are_refused(flown, tmp_path, name, seconds, field):
    with pytest.raises(InputError, match=f"^{field}: "):
        save_film(flown.flight, tmp_path / name, seconds=seconds, world=flown.world)
    assert not list(tmp_path.iterdir())
