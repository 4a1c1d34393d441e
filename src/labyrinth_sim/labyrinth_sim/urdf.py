# SPDX-License-Identifier: Apache-2.0
"""A rig as URDF, which RViz, rqt and robot_state_publisher read: `ros2 run labyrinth_sim urdf MODEL`.

Written from the MJCF as MuJoCo compiles it. Joints are named as in joint_states. Left out is what URDF lacks:
belts and actuators, bodies that move freely such as the ball, and geoms that are meshes or height fields.
"""

import argparse
import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from labyrinth_sim.asset import compile_spec, read_spec
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.rig import Rig
from labyrinth_sim.trials import Array

HALF_PLANE = 0.5  # m; an infinite plane is drawn as a plate of twice this width
PLATE = 0.001  # m, its thickness
UNLIMITED = 1000.0  # N m or N, and rad/s or m/s; URDF wants a number where nothing limits effort and speed
SHAPES = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_PLANE): "plane",
}


def urdf(rig: Rig) -> str:
    """The rig's URDF: one link for each body and joint, one joint for each hinge and slide joint.

    A link's frame is that of its body, moved to the joint that carries it. Angles are those of joint_states, with the
    MJCF's reference position at zero.

    Raises:
        InputError: the MJCF does not compile.
    """
    if rig.mjcf.suffix == ".urdf":
        return rig.mjcf.read_text(encoding="utf-8")
    model = compile_spec(read_spec(rig.mjcf), rig.mjcf)
    sites = (rig.ball.site,) if rig.ball else ()
    return urdf_of(model, rig.name, {a.joint: a.command for a in rig.axes}, sites)


def urdf_of(model: mujoco.MjModel, name: str, names: Mapping[str, str], sites: Sequence[str] = ()) -> str:
    """A compiled model's URDF.

    Args:
        names: joints of the MJCF -> those of joint_states where they differ.
        sites: those that become links of their own, as frames of messages.
    """
    robot = ET.Element("robot", name=name)
    carriers = {0: ("world", np.zeros(3))}  # body -> its link, and where the body's origin is in the link's frame, m
    _draw(ET.SubElement(robot, "link", name="world"), model, 0, np.zeros(3))
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = [first + i for i in range(count)]
        kinds = {int(model.jnt_type[joint]) for joint in joints}
        if parent not in carriers or kinds & {mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL}:
            continue
        link, origin = carriers[parent]
        place = origin + model.body_pos[body]
        rotation = _matrix(model.body_quat[body])
        body_name = model.body(body).name or f"body_{body}"
        before = np.zeros(3)  # of the joint before, in the body's frame
        for i, joint in enumerate(joints):
            last = i == len(joints) - 1
            child = body_name if last else f"{body_name}_{i}"
            anchor = np.array(model.jnt_pos[joint])
            pose = (place + rotation @ anchor, rotation) if i == 0 else (anchor - before, np.eye(3))
            _joint(robot, model, joint, names, link, child, pose)
            link, before = child, anchor
            element = ET.SubElement(robot, "link", name=child)
        if not joints:
            element = ET.SubElement(robot, "link", name=body_name)
            fixed = ET.SubElement(robot, "joint", name=f"{body_name}_fixed", type="fixed")
            _ends(fixed, link, body_name, (place, rotation))
            link = body_name
        carriers[body] = (link, -before)
        _weigh(element, model, body, -before)
        _draw(element, model, body, -before)
    for site in (model.site(name) for name in sites):
        link, origin = carriers[int(site.bodyid[0])]
        ET.SubElement(robot, "link", name=site.name)
        fixed = ET.SubElement(robot, "joint", name=f"{site.name}_fixed", type="fixed")
        _ends(fixed, link, site.name, (origin + site.pos, _matrix(site.quat)))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _joint(
    robot: ET.Element, model: mujoco.MjModel, joint: int, names: Mapping[str, str], parent: str, child: str,
    pose: tuple[Array, Array],
) -> None:  # fmt: skip
    name = model.joint(joint).name or f"joint_{joint}"
    slides, limited = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE, bool(model.jnt_limited[joint])
    kind = "prismatic" if slides else "revolute" if limited else "continuous"
    element = ET.SubElement(robot, "joint", name=names.get(name, name), type=kind)
    _ends(element, parent, child, pose)
    ET.SubElement(element, "axis", xyz=_text(model.jnt_axis[joint]))
    limit = ET.SubElement(element, "limit", effort=f"{UNLIMITED:g}", velocity=f"{UNLIMITED:g}")
    if kind != "continuous":
        low, high = model.jnt_range[joint] if limited else (-UNLIMITED, UNLIMITED)
        limit.attrib.update(lower=f"{low:.9g}", upper=f"{high:.9g}")


def _ends(joint: ET.Element, parent: str, child: str, pose: tuple[Array, Array]) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    _origin(joint, *pose)


def _weigh(link: ET.Element, model: mujoco.MjModel, body: int, origin: Array) -> None:
    if not model.body_mass[body] > 0.0:
        return
    inertial = ET.SubElement(link, "inertial")
    _origin(inertial, origin + model.body_ipos[body], _matrix(model.body_iquat[body]))
    ET.SubElement(inertial, "mass", value=f"{model.body_mass[body]:.9g}")
    ixx, iyy, izz = (f"{value:.9g}" for value in model.body_inertia[body])
    ET.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")


def _draw(link: ET.Element, model: mujoco.MjModel, body: int, origin: Array) -> None:
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        shape, size = SHAPES.get(int(model.geom_type[geom])), model.geom_size[geom]
        if shape is None:
            continue
        visual = ET.SubElement(link, "visual")
        if model.geom(geom).name:
            visual.set("name", model.geom(geom).name)
        _origin(visual, origin + model.geom_pos[geom], _matrix(model.geom_quat[geom]))
        geometry = ET.SubElement(visual, "geometry")
        if shape == "sphere":
            ET.SubElement(geometry, "sphere", radius=f"{size[0]:.9g}")
        elif shape in ("cylinder", "capsule"):
            length = 2 * size[1] + (2 * size[0] if shape == "capsule" else 0.0)
            ET.SubElement(geometry, "cylinder", radius=f"{size[0]:.9g}", length=f"{length:.9g}")
        else:
            half = size if shape == "box" else np.array([*(w if w > 0 else HALF_PLANE for w in size[:2]), PLATE / 2])
            ET.SubElement(geometry, "box", size=_text(2 * half))
        paint = int(model.geom_matid[geom])
        colour = model.mat_rgba[paint] if paint >= 0 else model.geom_rgba[geom]
        material = ET.SubElement(visual, "material", name=model.mat(paint).name if paint >= 0 else f"geom_{geom}")
        ET.SubElement(material, "color", rgba=_text(colour))


def _matrix(quaternion: Array) -> Array:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, float))
    return matrix.reshape(3, 3)


def _origin(element: ET.Element, place: Array, rotation: Array) -> None:
    """URDF's roll, pitch, yaw turn about the fixed axes x, y, z one after the other."""
    pitch = math.asin(max(-1.0, min(1.0, -rotation[2, 0])))
    if abs(rotation[2, 0]) < 1.0 - 1e-9:
        roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    else:  # roll and yaw are one turn there
        roll, yaw = math.atan2(-rotation[1, 2], rotation[1, 1]), 0.0
    ET.SubElement(element, "origin", xyz=_text(place), rpy=_text(np.array([roll, pitch, yaw])))


def _text(values: Array) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in values)


def parser() -> argparse.ArgumentParser:
    """Options of `urdf`."""
    p = argparse.ArgumentParser(prog="urdf", description="Writes a model's rig as URDF to stdout.")
    p.add_argument("model", nargs="?", default="labyrinth", help="name or path of a model (default: %(default)s)")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run labyrinth_sim urdf`. Exit code 2 for bad input."""
    try:
        print(urdf(load_model(parser().parse_args(arguments).model).rig), end="")
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
