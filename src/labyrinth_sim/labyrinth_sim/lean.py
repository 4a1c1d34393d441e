# SPDX-License-Identifier: Apache-2.0
"""A structure as roll-outs need it: without what is only drawn, and meshes as the convex hulls that MuJoCo collides.

A robot's meshes take tens of MB in each compiled model, and a diagnosis compiles many.
"""

import mujoco
import numpy as np

from labyrinth_sim.trials import Array


def make_lean(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> None:
    """Leaves out of a specification what no roll-out needs; `compiled` is the same, compiled. It moves as before.

    A mesh from which MuJoCo infers the inertia of its body, or fits another shape, is left as it is.
    """
    inferred = spec.compiler.inertiafromgeom == int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
    kept = {
        geom.meshname
        for body in spec.bodies
        for geom in body.geoms
        if inferred or not body.explicitinertial or geom.type != mujoco.mjtGeom.mjGEOM_MESH
    }
    spec.compiler.discardvisual = True
    for mesh in list(spec.meshes):
        number = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_MESH, mesh.name)
        if mesh.name in kept or number < 0 or compiled.mesh_graphadr[number] < 0:
            continue
        small = spec.add_mesh(name=f"{mesh.name} hull", uservert=hull(compiled, number).ravel())
        for geom in (g for g in spec.geoms if g.meshname == mesh.name):
            geom.meshname = small.name
        spec.delete(mesh)


def hull(compiled: mujoco.MjModel, number: int) -> Array:
    """(n, 3) vertices of a mesh's convex hull, in the frame of its file after its scale."""
    graph = compiled.mesh_graph[compiled.mesh_graphadr[number] :]
    corners = compiled.mesh_vertadr[number] + graph[2 + graph[0] : 2 + 2 * graph[0]]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, compiled.mesh_quat[number])
    return np.asarray(compiled.mesh_vert[corners] @ turn.reshape(3, 3).T + compiled.mesh_pos[number])
