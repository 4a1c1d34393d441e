# SPDX-License-Identifier: Apache-2.0
"""The labyrinth's MJCF files say what the geometry says."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from labyrinth_sim.errors import InputError
from labyrinth_sim.mjcf.__main__ import labyrinth_files, main
from labyrinth_sim.mjcf.geometry import load_geometry
from labyrinth_sim.mjcf.labyrinth import BELT_RATIO, TIMESTEP, floor_tiles, hole_wedges, labyrinth_xml, polygon_inradius

CONFIG = Path(__file__).parents[1] / "config"
LAYOUTS = load_geometry(CONFIG / "labyrinth_geometry.yaml")
COMMITTED = sorted(p.name for p in (CONFIG / "mjcf").glob("*.xml") if p.stem.startswith(("labyrinth", "cyberrunner")))


def test_committed_files_are_what_the_generator_makes() -> None:
    committed = {name: (CONFIG / "mjcf" / name).read_text(encoding="utf-8") for name in COMMITTED}
    assert committed == labyrinth_files(LAYOUTS)


@pytest.mark.parametrize("name", COMMITTED)
def test_every_file_has_the_same_axes(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(CONFIG / "mjcf" / name))
    for joint in ("motor_x", "motor_y", "board_x", "board_y"):
        assert model.sensor(joint).type[0] == mujoco.mjtSensor.mjSENS_JOINTPOS
        assert model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_HINGE
    for axis in "xy":
        assert model.actuator(f"motor_{axis}").trnid[0] == model.joint(f"motor_{axis}").id
        assert model.tendon_stiffness[model.tendon(f"belt_{axis}").id] > 0
    assert (model.nv == 4) == name.endswith("plain.xml")


def test_plain_board_swings_like_the_one_with_walls() -> None:
    plain = mujoco.MjModel.from_xml_string(labyrinth_xml(LAYOUTS["easy"], plain=True))
    full = mujoco.MjModel.from_xml_string(labyrinth_xml(LAYOUTS["hard"]))
    for body in ("frame", "board", "motor_x", "motor_y"):
        assert plain.body(body).mass == full.body(body).mass
        np.testing.assert_array_equal(plain.body(body).inertia, full.body(body).inertia)


@pytest.mark.parametrize("name", LAYOUTS)
def test_floor_is_everywhere_but_in_the_holes(name: str) -> None:
    layout = LAYOUTS[name]
    tolerance = layout.hole_radius - polygon_inradius(layout.hole_radius) + 1e-6
    tops = [tile.top for tile in floor_tiles(np.zeros(2), layout.board_size, layout.holes, layout.hole_radius)]
    feet = [tile.foot for tile in floor_tiles(np.zeros(2), layout.board_size, layout.holes, layout.hole_radius)]
    for hole in layout.holes:
        tops += [wedge.top + hole for wedge in hole_wedges(layout.hole_radius)]
        feet += [wedge.foot + hole for wedge in hole_wedges(layout.hole_radius)]
    points = np.random.default_rng(0).uniform(0, layout.board_size, (4000, 2))
    rim = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    ring = np.column_stack([np.cos(rim), np.sin(rim)])
    for factor in (-1.01, 1.01):
        around = (hole + (layout.hole_radius + factor * tolerance) * ring for hole in layout.holes)
        points = np.concatenate([points, *around])
    points = points[((points > 0) & (points < layout.board_size)).all(axis=1)]
    distance = np.linalg.norm(points[:, None] - layout.holes, axis=-1).min(axis=1)
    covered = np.any([_inside(points, top) for top in tops], axis=0)
    solid = np.any([_inside(points, foot) for foot in feet], axis=0)
    assert covered[distance > layout.hole_radius + tolerance].all()
    assert not solid[distance < layout.hole_radius - tolerance].any()


def _inside(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    sides = np.roll(polygon, -1, axis=0) - polygon
    to = points[:, None] - polygon
    return (sides[:, 0] * to[..., 1] - sides[:, 1] * to[..., 0] >= -1e-12).all(axis=1)


def test_holes_too_close_for_the_floor_are_told() -> None:
    with pytest.raises(InputError, match=r"Holes 1 and 2 are 15\.0 mm apart"):
        floor_tiles(np.zeros(2), np.array([0.2, 0.2]), np.array([[0.1, 0.1], [0.115, 0.1]]), 0.007)


@pytest.mark.parametrize("timestep", [TIMESTEP / 2, TIMESTEP, 2 * TIMESTEP])
def test_belt_carries_the_board_along_and_comes_to_rest(timestep: float) -> None:
    spec = mujoco.MjSpec.from_string(labyrinth_xml(LAYOUTS["easy"], plain=True))
    spec.option.timestep = timestep
    for axis in "xy":
        spec.joint(f"motor_{axis}").armature = 1e3  # a motor held by its drive
    model = spec.compile()
    data = mujoco.MjData(model)
    for axis, angle in (("x", 0.06), ("y", -0.09)):
        data.joint(f"motor_{axis}").qpos = angle
    mujoco.mj_step(model, data, nstep=round(0.5 / timestep))
    for axis, angle in (("x", 0.06), ("y", -0.09)):
        assert data.joint(f"board_{axis}").qpos[0] == pytest.approx(BELT_RATIO * angle, abs=1e-4)
        assert abs(data.joint(f"board_{axis}").qvel[0]) < 1e-4


def test_every_complaint_about_a_geometry_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (CONFIG / "labyrinth_geometry.yaml").read_text(encoding="utf-8")
    broken = tmp_path / "broken.yaml"
    broken.write_text(text.replace("ball_radius:", "ball_radios:").replace("wall_height:", "#"), encoding="utf-8")
    assert main([str(broken), str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "'ball_radios'. Did you mean 'ball_radius'?" in told
    assert "'wall_height' is missing" in told
    with pytest.raises(InputError, match=r"hole 1 at .* reaches beyond the board"):
        replace(LAYOUTS["easy"], holes=np.array([[0.003, 0.1]]))
    with pytest.raises(InputError, match="cannot be read"):
        load_geometry(tmp_path / "missing.yaml")
