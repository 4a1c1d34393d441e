# SPDX-License-Identifier: Apache-2.0
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from labyrinth_hw.camera import Camera
from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.renderer import Renderer
from labyrinth_hw.testbed.scene import Layout, Lens, Lighting, Scene, load_layout
from labyrinth_hw.testbed.video import CAMERA_LATENCY, Outgoing, VideoStream

PLAIN = Layout(board=(0.276, 0.231), walls=(), holes=(), path=())
CALM = Lighting(noise=0.0, blur=0.0, shadow=0.0, warmth=0.0)


def test_same_seed_same_picture() -> None:
    scene = Scene(ball=(0.1, 0.1), tilt=(0.05, -0.02))
    one, two, other = (Renderer(PLAIN, seed=seed).render(scene) for seed in (3, 3, 4))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)


def test_noise_has_the_size_asked_for() -> None:
    light = replace(CALM, noise=4.0)
    renderer = Renderer(PLAIN, Lens.at_height(0.25), light)
    scene = Scene()
    difference = (renderer.render(scene).astype(float) - renderer.render(scene))[20:60, 20:90]  # plain table
    level = renderer.render(scene)[20:60, 20:90].mean()
    assert np.std(difference) / np.sqrt(2) == pytest.approx(4.0 * np.sqrt(1 + level / 128), rel=0.1)


@pytest.mark.parametrize("place", [(0.03, 0.03), (0.138, 0.1155), (0.25, 0.2)])
def test_the_ball_covers_where_a_sphere_projects(place: tuple[float, float]) -> None:
    """The silhouette of a sphere is where rays touch it: compared with points of its outline projected by hand."""
    lens = Lens.at_height(0.25)
    renderer = Renderer(PLAIN, lens, CALM)
    tilt = (0.06, -0.08)
    changed = np.abs(renderer.render(Scene(ball=place, tilt=tilt)).astype(int) - renderer.render(Scene(tilt=tilt)))
    rotation, translation = renderer.board_pose(tilt)
    centre = rotation @ np.array([*place, 0.00635]) + translation
    away = centre / np.linalg.norm(centre)
    across = np.cross(away, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, 60)[:, None]
    circle = np.cos(angle) * across + np.sin(angle) * np.cross(away, across)
    for share, inside in ((0.6, True), (2.6, False)):  # beyond: no change but what the contact shadow leaves
        outline = centre + share * 0.00635 * circle
        pixels = np.round(outline[:, :2] / outline[:, 2:] * lens.focal + (319.5, 179.5)).astype(int)
        values = changed.sum(2)[pixels[:, 1], pixels[:, 0]]
        assert (values > 8).mean() > 0.9 if inside else (values < 8).all()


def test_a_moving_ball_is_the_mean_of_balls_along_its_way() -> None:
    renderer = Renderer(PLAIN, Lens.at_height(0.25), CALM)
    middle, velocity, exposure = np.array([0.138, 0.1155]), np.array([0.5, 0.2]), 0.01
    smeared = renderer.render(Scene(ball=(0.138, 0.1155), velocity=(0.5, 0.2), exposure=exposure)).astype(float)
    errors = []
    for length in (0.0, 0.5, 1.0, 1.5):  # of the way that the ball really goes
        places = middle + length * np.linspace(-0.5, 0.5, 17)[:, None] * velocity * exposure
        mean = np.mean([renderer.render(Scene(ball=(float(x), float(y)))) for x, y in places], axis=0)
        errors.append(np.abs(mean - smeared).sum())
    assert np.argmin(errors) == 2, errors
    assert errors[2] < 0.5 * errors[0]  # the shade on the floor is not smeared


def test_a_wall_hides_a_ball_behind_it() -> None:
    """Camera over the middle, ball at the rim: a tall wall between them covers it, one beyond does not."""
    ball = (0.25, 0.1155)
    shown = []
    for x in (0.2410, 0.2590):
        board = replace(PLAIN, wall_height=0.03, walls=((x - 0.0025, 0.09, x + 0.0025, 0.14),))
        renderer = Renderer(board, Lens.at_height(0.25), CALM)
        colours = renderer.render(Scene(ball=ball)).astype(int)
        neutral = colours[:, :, 0] > 0.8 * colours[:, :, 2]
        row = round(179.5)
        shown.append(int(neutral[row - 8 : row + 9, 420:500].sum()))
    assert shown[1] > 50
    assert shown[0] < 0.2 * shown[1]


def test_an_unknown_layout_is_refused_with_the_valid_names() -> None:
    with pytest.raises(InputError, match="easy"):
        load_layout("esy")


def test_a_camera_reads_a_video_file_at_the_file_s_rate(tmp_path: Path) -> None:
    path = tmp_path / "video.avi"
    frame = Renderer(PLAIN).render(Scene())
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 60.0, (640, 360))
    for _ in range(5):
        video.write(frame)
    video.release()
    with Camera(str(path)) as camera:
        shot = camera.newest(4, timeout=5.0)
    assert shot is not None
    assert np.abs(shot.image.astype(int) - frame).mean() < 3


@pytest.mark.realtime
def test_a_camera_survives_its_stream_vanishing_and_says_so() -> None:
    frame = Renderer(PLAIN).render(Scene())
    told: list[str] = []
    over = threading.Event()
    streams = [VideoStream()]
    port = streams[0].port

    def feed() -> None:
        while not over.wait(0.01):
            streams[-1].push(frame)

    feeder = threading.Thread(target=feed)
    feeder.start()
    try:
        with Camera(streams[0].url, latency=0.02, retry=0.1, on_change=told.append) as camera:
            before = time.time()
            shot = camera.newest(timeout=90.0)
            assert shot is not None
            assert shot.image.shape == (360, 640, 3)
            assert before - 0.5 < shot.stamp < time.time() - 0.02
            streams[0].close()
            deadline = time.monotonic() + 90
            while camera.state.connected and time.monotonic() < deadline:
                time.sleep(0.02)
            assert not camera.state.connected
            lost_at = camera.state.frames
            streams.append(VideoStream(port))
            back = camera.newest(lost_at, timeout=90.0)
            assert back is not None
            assert back.number > lost_at
            assert camera.state.losses == 1
        assert "delivers" in told[0]
        assert "stopped" in told[1]
        assert "delivers" in told[-1]
    finally:
        over.set()
        feeder.join()
        streams[-1].close()


def test_pictures_leave_a_fixed_time_after_their_scene_and_late_ones_are_dropped() -> None:
    left: list[tuple[float, float]] = []
    with VideoStream() as stream:
        stream.push = lambda frame: left.append((time.monotonic(), float(frame[0, 0, 0])))  # type: ignore
        outgoing = Outgoing(stream)
        for number in range(1, 100):
            taken = time.monotonic()
            outgoing.put(taken - CAMERA_LATENCY - 1.0, np.zeros((2, 2, 3), np.uint8))
            outgoing.put(taken, np.full((2, 2, 3), number, np.uint8))
            time.sleep(1.5 * CAMERA_LATENCY)
            if left:  # a busy machine may be late for one
                break
        outgoing.close()
    assert [shown for _, shown in left] == [number]
    assert left[0][0] >= taken + CAMERA_LATENCY


def test_a_stream_on_a_used_port_is_refused() -> None:
    with VideoStream() as stream, pytest.raises(InputError, match="another port"):
        VideoStream(stream.port)
