# SPDX-License-Identifier: Apache-2.0
"""Models of robots with meshes, made small for roll-outs."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from labyrinth_sim.lean import make_lean
from labyrinth_sim.trials import Array

SIDES = np.array([0.1, 0.06, 0.04])
INERTIAL = '<inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 2e-4 2e-4"/>'
AWAY = np.array([0.3, -0.2, 0.1])  # of the block from the origin of its file


def write_block(file: Path) -> None:
    """A block, of many faces, as a mesh with another size and place than the model gives it."""
    lines, corners = [], []
    for axis in range(3):
        for end in (0.0, 1.0):
            for i in range(8):
                for j in range(8):
                    quad = []
                    for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                        point = np.empty(3)
                        point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3] = end, a / 8.0, b / 8.0
                        corners.append(1e3 * ((point - 0.5) * SIDES + AWAY))
                        quad.append(len(corners))
                    quad = quad if end else quad[::-1]
                    lines += [f"f {quad[0]} {quad[1]} {quad[2]}", f"f {quad[0]} {quad[2]} {quad[3]}"]
    file.write_text("\n".join([f"v {x} {y} {z}" for x, y, z in corners] + lines) + "\n")


def block(folder: Path, inertial: str, compiler: str = "", shape: str = "mesh") -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    write_block(folder / "block.obj")
    text = f"""<mujoco><compiler {compiler}/><option timestep="0.001"/><asset>
      <mesh name="block" file="{folder}/block.obj" scale="0.001 0.001 0.001" refpos="0.3 -0.2 0.05"/></asset>
      <worldbody><geom type="plane" size="1 1 0.1"/>
      <body pos="0 0 0.2" euler="20 30 0"><freejoint name="free"/>{inertial}
      <geom type="{shape}" mesh="block" density="500"/>
      <geom type="mesh" mesh="block" contype="0" conaffinity="0" mass="0"/>
      </body></worldbody></mujoco>"""
    (folder / "model.xml").write_text(text)
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    return spec, spec.compile()


def fallen(mj: mujoco.MjModel) -> Array:
    data = mujoco.MjData(mj)
    seen = []
    for _ in range(400):
        mujoco.mj_step(mj, data)
        seen.append(np.array(data.qpos))
    assert data.ncon > 0
    return np.array(seen)


def test_a_mesh_is_its_hull_and_falls_as_before(tmp_path: Path) -> None:
    spec, full = block(tmp_path, INERTIAL)
    make_lean(spec, full)
    lean = spec.compile()
    assert lean.ngeom == 2, "what is only drawn is left out"
    assert lean.nmeshvert == 8
    assert full.nmeshvert > 100
    assert lean.geom_pos[1] == pytest.approx(full.geom_pos[1], abs=1e-6)
    assert fallen(lean) == pytest.approx(fallen(full), abs=1e-3)


@pytest.mark.parametrize(
    ("inertial", "compiler", "shape"),
    [("", "", "mesh"), (INERTIAL, 'inertiafromgeom="true"', "mesh"), (INERTIAL, "", "ellipsoid")],
)
def test_a_mesh_that_weighs_or_gives_another_shape_its_size_is_left_as_it_is(
    tmp_path: Path, inertial: str, compiler: str, shape: str
) -> None:
    spec, full = block(tmp_path, inertial, compiler, shape)
    make_lean(spec, full)
    lean = spec.compile()
    assert shape != "mesh" or lean.nmeshvert == full.nmeshvert
    assert lean.geom_size[1] == pytest.approx(full.geom_size[1])
    assert lean.body_mass == pytest.approx(full.body_mass)
    assert lean.body_inertia == pytest.approx(full.body_inertia)
