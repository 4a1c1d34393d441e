# SPDX-License-Identifier: Apache-2.0
"""The ball rolls, falls, is lost and supplied as physics and the layout say."""

from pathlib import Path

import mujoco
import mujoco.batch
import numpy as np
import pytest

from labyrinth_sim.ball import ON_BOARD, OVER_THE_RIM, BallGame
from labyrinth_sim.errors import InputError
from labyrinth_sim.mjcf.geometry import Layout, load_geometry
from labyrinth_sim.mjcf.labyrinth import labyrinth_xml

LAYOUTS = load_geometry(Path(__file__).parents[1] / "config" / "labyrinth_geometry.yaml")
GRAVITY = 9.81


def held_board(layout: Layout, walls: bool) -> mujoco.MjModel:
    """The board without gimbals or drives, level; a test tilts gravity instead."""
    spec = mujoco.MjSpec.from_string(labyrinth_xml(layout))
    for elements in (spec.sensors, spec.actuators, spec.tendons):
        for element in list(elements):
            spec.delete(element)
    for joint in list(spec.joints):
        if joint.name != "ball":
            spec.delete(joint)
    for geom in list(spec.geoms):
        if not walls and geom.name.startswith(("wall_", "rim_")):
            spec.delete(geom)
    return spec.compile()


def roll(layout: Layout, start: np.ndarray, tilt: np.ndarray, direction: np.ndarray, steps: int) -> np.ndarray:
    """(n, steps, 3) m, balls released at rest at `start` (n, 2) on floors tilted by `tilt` (n,) towards `direction`."""
    model = held_board(layout, walls=False)
    batch = mujoco.batch.Batch(model, len(start), 2)
    origin = model.site("board_origin").pos + model.body("frame").pos
    batch.qpos[:, :2] = start + origin[:2]
    batch.qpos[:, 2] = layout.ball_radius + origin[2] - 1e-6
    flat = [np.sin(tilt) * np.cos(direction), np.sin(tilt) * np.sin(direction), -np.cos(tilt)]
    batch.expand("opt.gravity")[:] = GRAVITY * np.stack(flat, axis=1)
    return np.asarray(batch.rollout(steps, record=("qpos",))["qpos"][..., :3] - origin)


@pytest.mark.parametrize("name", LAYOUTS)
def test_ball_rolls_with_five_sevenths_of_g_across_all_seams(name: str) -> None:
    layout, step, steps, count = LAYOUTS[name], 0.002, 150, 500
    rng = np.random.default_rng(7)
    start = rng.uniform(0.005, layout.board_size - 0.005, (count, 2))
    tilt, direction = np.radians(rng.choice([1.0, 2.0, 3.0, 5.0, 8.0], count)), rng.uniform(0, 2 * np.pi, count)
    acceleration = 5 / 7 * GRAVITY * np.sin(tilt)
    time = step * np.arange(1, steps + 1)
    ahead = np.stack([np.cos(direction), np.sin(direction)], axis=1)
    way = start[:, None] + ahead[:, None] * (acceleration[:, None] * time**2 / 2)[..., None]
    clear = np.linalg.norm(way[:, :, None] - layout.holes, axis=-1).min(axis=(1, 2)) > layout.hole_radius + 3e-4
    clear &= ((way > 0) & (way < layout.board_size)).all(axis=(1, 2))
    assert clear.sum() > 200
    seen = roll(layout, start, tilt, direction, steps)[clear]
    along = ((seen[..., :2] - start[clear, None]) * ahead[clear, None]).sum(axis=-1)
    fit = np.linalg.lstsq(np.column_stack([time**2 / 2, time, np.ones(steps)])[20:], along[:, 20:].T, rcond=None)[0]
    np.testing.assert_allclose(fit[0], acceleration[clear], rtol=0.01)
    assert np.median(np.abs(fit[0] / acceleration[clear] - 1)) < 0.001


@pytest.mark.parametrize("name", LAYOUTS)
def test_ball_falls_inside_the_edge_of_every_hole_and_stays_outside(name: str) -> None:
    layout = LAYOUTS[name]
    game = BallGame.of(mujoco.MjModel.from_xml_string(labyrinth_xml(layout)))
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False) + 0.1
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    for offset, falls in ((-0.0004, True), (0.0003, False)):
        start = (layout.holes[:, None] + (layout.hole_radius + offset) * ring).reshape(-1, 2)
        level = np.zeros(len(start))
        end = roll(layout, start, level, level, 120)
        loss = game.loss(end)
        expected = np.repeat(np.arange(1, len(layout.holes) + 1), len(angles))
        first = np.take_along_axis(loss, (loss != ON_BOARD).argmax(axis=1)[:, None], axis=1)[:, 0]
        np.testing.assert_array_equal(first, expected if falls else ON_BOARD)


def test_path_avoids_walls_and_holes() -> None:
    for layout in LAYOUTS.values():
        assert np.linalg.norm(layout.path[:, None] - layout.holes, axis=-1).min() > layout.hole_radius
        for x0, x1, y0, y1 in layout.walls():
            assert not ((layout.path > (x0, y0)) & (layout.path < (x1, y1))).all(axis=1).any()


def test_position_agrees_with_the_sensor_at_any_tilt() -> None:
    model = mujoco.MjModel.from_xml_string(labyrinth_xml(LAYOUTS["medium"]))
    game, data = BallGame.of(model), mujoco.MjData(model)
    for a, b in ((0.0, 0.0), (0.1, -0.07), (-0.13, 0.12)):
        data.joint("board_x").qpos, data.joint("board_y").qpos = a, b
        game.supply(data.qpos, data.qvel, at=(0.05, 0.16))
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.sensor("ball").data, (0.05, 0.16, game.ball_radius), atol=1e-9)
        np.testing.assert_allclose(game.position(data.qpos), data.sensor("ball").data, atol=1e-9)


def test_supplied_ball_rests_at_the_start_whatever_happened_before() -> None:
    layout = LAYOUTS["hard"]
    model = mujoco.MjModel.from_xml_string(labyrinth_xml(layout))
    game = BallGame.of(model)
    qpos, qvel = np.tile(model.qpos0, (3, 1)), np.ones((3, model.nv))
    qpos[:, game.ball_qpos : game.ball_qpos + 3] = 5.0
    assert (game.loss(game.position(qpos)) == OVER_THE_RIM).all()
    game.supply(qpos[1:], qvel[1:])
    assert game.loss(game.position(qpos)).tolist() == [OVER_THE_RIM, ON_BOARD, ON_BOARD]
    np.testing.assert_allclose(game.position(qpos)[1:, :2], [layout.start] * 2, atol=1e-12)
    assert (qvel[1:, game.ball_qvel :] == 0).all()
    assert (qvel[:, : game.ball_qvel] == 1).all()


def test_tilt_signs() -> None:
    """Positive board_y rolls the ball to +x, positive board_x to -y."""
    model = mujoco.MjModel.from_xml_string(labyrinth_xml(LAYOUTS["easy"]))
    game = BallGame.of(model)
    for joint, axis, sign in (("board_y", 0, 1), ("board_x", 1, -1)):
        data = mujoco.MjData(model)
        game.supply(data.qpos, data.qvel, at=(0.13, 0.17))
        for _ in range(100):
            data.joint(joint).qpos, data.joint(joint).qvel = 0.05, 0.0
            mujoco.mj_step(model, data)
        moved = game.position(data.qpos)[:2] - (0.13, 0.17)
        assert sign * moved[axis] > 0.003


def test_model_without_a_ball_is_refused_with_all_that_is_missing() -> None:
    model = mujoco.MjModel.from_xml_string(labyrinth_xml(LAYOUTS["easy"], plain=True))
    with pytest.raises(InputError, match="no joint 'ball'") as raised:
        BallGame.of(model)
    assert len(raised.value.complaints) == 3
