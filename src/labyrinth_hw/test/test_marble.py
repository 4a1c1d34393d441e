# SPDX-License-Identifier: Apache-2.0
"""A painted marble is found by a colour learned from one click, in other light and through other lenses."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_views import CLOSE, CROOKED, free_place, intrinsics, layout

from labyrinth_hw.ball_tracker import BallTracker
from labyrinth_hw.errors import InputError
from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
from labyrinth_hw.marble import Marble
from labyrinth_hw.nodes.calibrate_camera import main
from labyrinth_hw.settings import load_hardware
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.renderer import Frame, Renderer
from labyrinth_hw.testbed.scene import Lens, Lighting, Scene

COLOURS = {"blue": (190, 70, 30), "green": (50, 150, 40), "red": (40, 40, 200), "white": (215, 220, 220)}  # BGR


def clicked_picture(colour: tuple[int, int, int]) -> tuple[Frame, tuple[int, int]]:
    """A close view of a marble, and a click on its middle, px."""
    place, radius = (0.11, 0.09), 0.00635
    frame = Renderer(layout("hard"), CLOSE, seed=1, marble=colour).render(Scene(ball=place))
    pose = LandmarkTracker(DotPlan.from_sizes(), intrinsics(CLOSE)).update(frame)
    assert pose is not None, "a marble as blue as the dots is none of them"
    x, y = np.round(pose.to_image(np.array([[*place, radius]]))[0])
    return frame, (int(x), int(y))


@pytest.mark.parametrize(
    ("colour", "lens"),
    [("blue", CLOSE), ("green", CLOSE), ("red", CLOSE), ("white", CLOSE), ("blue", CROOKED)],
    ids=["blue", "green", "red", "white", "blue, crooked"],
)
def test_a_marble_is_found_by_the_colour_of_one_click(colour: str, lens: Lens) -> None:
    marble = Marble.clicked(*clicked_picture(COLOURS[colour]))
    rng = np.random.default_rng(7)
    errors = []
    for room in range(2):
        board = layout(("easy", "medium", "hard")[room])
        renderer = Renderer(board, lens, Lighting.drawn(rng), seed=room, marble=COLOURS[colour])
        marks, tracker = LandmarkTracker(DotPlan.from_sizes(), intrinsics(lens)), BallTracker(marble=marble)
        for _ in range(4):
            place = free_place(board, rng)
            tilt = (float(rng.uniform(-0.1, 0.1)), float(rng.uniform(-0.1, 0.1)))
            frame = renderer.render(Scene(ball=(float(place[0]), float(place[1])), tilt=tilt))
            seen = tracker.update(frame, marks.update(frame), 0.0)
            errors.append(np.hypot(seen.x - place[0], seen.y - place[1]))
    assert np.mean(np.isfinite(errors)) >= 7 / 8
    assert np.sqrt(np.nanmean(np.square(errors))) < 1e-3


def test_an_empty_board_shows_no_blue_marble() -> None:
    marble = Marble.clicked(*clicked_picture(COLOURS["blue"]))
    frame = Renderer(layout("hard"), CLOSE, seed=3).render(Scene(tilt=(0.05, -0.04)))
    pose = LandmarkTracker(DotPlan.from_sizes(), intrinsics(CLOSE)).update(frame)
    assert not BallTracker(marble=marble).update(frame, pose, 0.0).visible


def test_one_click_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame, (x, y) = clicked_picture(COLOURS["blue"])
    picture, out = tmp_path / "picture.png", tmp_path / "marble.yaml"
    assert cv2.imwrite(str(picture), frame)
    assert main(["marble", "--source", str(picture), "--at", str(x), str(y), "--out", str(out)]) == 0
    learned = Marble.clicked(frame, (x, y))
    assert Marble.load(out).tint == pytest.approx(learned.tint, abs=1e-3)
    wood = ["marble", "--source", str(picture), "--at", "300", "100", "--out", str(tmp_path / "wood.yaml")]
    assert main(wood) == 2
    assert "too near the wood's colour" in capsys.readouterr().err


def test_a_click_beside_the_picture_is_refused() -> None:
    with pytest.raises(InputError, match="outside the picture of 640 x 360"):
        Marble.clicked(np.zeros((360, 640, 3), np.uint8), (640, 10))


def test_cyberrunners_file_names_the_marble_that_its_testbed_shows(tmp_path: Path) -> None:
    """Its camera as the emulated one, whose marble has the colour of config/testbed/cyberrunner.yaml."""
    camera = load_hardware("cyberrunner").camera
    assert camera is not None and camera.marble is not None
    shown = load_testbed("cyberrunner").marble
    assert shown == COLOURS["blue"]
    board, rng = layout("hard"), np.random.default_rng(3)
    renderer = Renderer(board, CLOSE, Lighting.drawn(rng), seed=2, marble=shown)
    marks, tracker = (
        LandmarkTracker(DotPlan.from_sizes(), intrinsics(CLOSE)),
        BallTracker(marble=Marble.load(camera.marble)),
    )
    seen = []
    for _ in range(6):
        place = free_place(board, rng)
        frame = renderer.render(Scene(ball=(float(place[0]), float(place[1]))))
        seen.append(tracker.update(frame, marks.update(frame), 0.0).visible)
    assert sum(seen) >= 5, "without its file none is seen"
    own = tmp_path / "own.yaml"
    own.write_text(
        "servo_port: {path: servos, baud: 1000000}\nmotors: {motor_x: {id: 1, model: XL330-M077}}\n"
        "camera: {source: testbed, marble: purple}\n"
    )
    with pytest.raises(InputError, match=r"camera, marble: .*cyberrunner_blue.*calibrate_camera marble"):
        load_hardware(own)
