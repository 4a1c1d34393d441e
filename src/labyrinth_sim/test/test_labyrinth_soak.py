# SPDX-License-Identifier: Apache-2.0
"""No wall and no floor lets the ball through, and none is hopped at the servo's own speed."""

from pathlib import Path

import mujoco
import mujoco.batch
import numpy as np
import pytest

from labyrinth_sim.ball import ON_BOARD, OVER_THE_RIM, BallGame
from labyrinth_sim.mjcf.geometry import Layout, load_geometry
from labyrinth_sim.mjcf.labyrinth import RIM_HEIGHT, STALL_TORQUE, labyrinth_xml

LAYOUTS = load_geometry(Path(__file__).parents[1] / "config" / "labyrinth_geometry.yaml")
BATCH, SEGMENT = 100, 500  # simulations; steps between checks for lost balls
SOAK = 600.0 / len(LAYOUTS)  # s of each layout


class Played:
    """Balls tossed about on one layout, supplied anew at a random point of the path when lost."""

    def __init__(self, layout: Layout, spec: mujoco.MjSpec, seed: int) -> None:
        model = spec.compile()
        self.layout, self.step, self.game = layout, model.opt.timestep, BallGame.of(model)
        self.rng = np.random.default_rng(seed)
        self.batch = mujoco.batch.Batch(model, BATCH, 2)
        self.seconds = 0.0
        self._supply(np.arange(BATCH))

    def _supply(self, which: np.ndarray) -> None:
        qpos, qvel = np.array(self.batch.qpos[which]), np.array(self.batch.qvel[which])
        self.game.supply(qpos, qvel, at=self.layout.path[self.rng.integers(len(self.layout.path), size=len(which))])
        self.batch.qpos[which], self.batch.qvel[which] = qpos, qvel

    def segment(self, amplitude: float, shortest: float, longest: float) -> tuple[np.ndarray, np.ndarray]:
        """(n, SEGMENT + 1, 3) m and (n, SEGMENT + 1) loss under random square waves of holds.

        shortest and longest hold in s. After its loss a ball's positions are NaN.
        """
        before = np.array(self.batch.qpos)
        control = self._square_waves(amplitude, shortest, longest)
        after = self.batch.rollout(SEGMENT, control=control, record=("qpos",))["qpos"]
        assert np.isfinite(after).all()
        position = self.game.position(np.concatenate([before[:, None], after], axis=1))
        loss = self.game.loss(position)
        lost = loss != ON_BOARD
        gone = np.cumsum(lost, axis=1) > 1
        self.seconds += float((~gone).sum() - BATCH) * self.step
        self._supply(np.flatnonzero(lost.any(axis=1)))
        return np.where(gone[..., None], np.nan, position), np.where(gone, ON_BOARD, loss)

    def _square_waves(self, amplitude: float, shortest: float, longest: float) -> np.ndarray:
        shape = (BATCH, 2, round(SEGMENT * self.step / shortest) + 1)
        ends = np.cumsum(self.rng.uniform(shortest, longest, shape), axis=-1)
        levels = amplitude * self.rng.choice([-1.0, 1.0], shape) * self.rng.uniform(0.3, 1.0, shape)
        time = self.step * np.arange(SEGMENT)
        hold = (ends[..., None] <= time).sum(axis=-2)
        return np.ascontiguousarray(np.take_along_axis(levels, hold, axis=-1).transpose(0, 2, 1))


def crossing_heights(position: np.ndarray, layout: Layout) -> np.ndarray:
    """Height of the ball's centre over the top of a wall or rim, each time it passes the wall's centre line, m."""
    edge = [(x, x, 0.0, layout.board_size[1]) for x in (0.0, layout.board_size[0])]
    edge += [(0.0, layout.board_size[0], y, y) for y in (0.0, layout.board_size[1])]
    obstacles = [(wall, layout.wall_height) for wall in layout.walls()] + [(wall, RIM_HEIGHT) for wall in edge]
    heights = []
    for (x0, x1, y0, y1), top in obstacles:
        along, across = (0, 1) if x1 - x0 > y1 - y0 else (1, 0)
        low, high = ((x0, x1), (y0, y1))[along]
        offset = position[..., across] - (((x0 + x1) / 2, (y0 + y1) / 2)[across])
        with np.errstate(invalid="ignore"):
            trial, k = np.nonzero(offset[:, 1:] * offset[:, :-1] < 0)
        part = offset[trial, k] / (offset[trial, k] - offset[trial, k + 1])
        point = position[trial, k] + part[:, None] * (position[trial, k + 1] - position[trial, k])
        within = (point[:, along] >= low) & (point[:, along] <= high) & (point[:, 2] > 0)
        heights.append(point[within, 2] - top)
    return np.concatenate(heights)


@pytest.mark.study
@pytest.mark.parametrize("name", LAYOUTS)
def test_ball_never_tunnels_in_ten_minutes_of_violent_tilting(name: str) -> None:
    """Ten on all layouts together, full torque, thrown about every 10 to 150 ms.

    Balls fly over walls, but none passes through one or the floor.
    """
    layout = LAYOUTS[name]
    played = Played(layout, mujoco.MjSpec.from_string(labyrinth_xml(layout)), seed=3)
    holes = hops = 0
    while played.seconds < SOAK:
        position, loss = played.segment(STALL_TORQUE, 0.01, 0.15)
        heights = crossing_heights(position, layout)
        assert (heights > 0).all(), f"the centre went through a wall, {-1e3 * heights.min():.2f} mm below its top"
        fallen = position[loss != ON_BOARD]
        number = loss[loss != ON_BOARD]
        into = number > 0
        away = np.linalg.norm(fallen[into, :2] - layout.holes[number[into] - 1], axis=-1)
        assert (away < layout.hole_radius).all(), "through the floor beside a hole"
        inside = ((fallen[:, :2] > 0) & (fallen[:, :2] < layout.board_size)).all(axis=1)
        assert not (inside & (number == OVER_THE_RIM)).any(), "through the floor"
        holes, hops = holes + int(into.sum()), hops + len(heights)
    assert holes > 20
    assert hops > 100


@pytest.mark.parametrize("name", LAYOUTS)
def test_ball_stays_in_its_corridor_at_the_servos_top_speed(name: str) -> None:
    """Steps anywhere in -5..5 deg; torque falls over the compliance slope and with speed."""
    layout = LAYOUTS[name]
    no_load_speed, slope = np.radians(60 / 0.172), np.radians(9.28)  # estimates for a DX-117 at 12 V
    spec = mujoco.MjSpec.from_string(labyrinth_xml(layout))
    for actuator in spec.actuators:
        gain = STALL_TORQUE / slope
        actuator.gainprm[0], actuator.biastype = gain, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[:3] = [0, -gain, -STALL_TORQUE / no_load_speed]
    played = Played(layout, spec, seed=4)
    position, _ = played.segment(np.radians(5), 0.2, 0.6)
    assert len(crossing_heights(position, layout)) == 0
    travelled = np.linalg.norm(np.diff(position[..., :2], axis=1), axis=-1)
    assert np.nansum(travelled) > 0.05 * played.seconds
