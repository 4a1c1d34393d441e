# SPDX-License-Identifier: Apache-2.0
"""An arm whose joints shake one another: friction in one of them is named, and nothing beside it."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks" / "sections"))

from six_joints import HIDDEN, JOINTS, arm, motion
from ten_diagnoses import timed_diagnosis

from eps_tunnel_analysis.diagnose.axes import diagnosed
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, joined
from eps_tunnel_analysis.diagnose.base_values import fitted_bases
from eps_tunnel_analysis.diagnose.doubts import notes_of
from eps_tunnel_analysis.diagnose.free_curves import free_curves
from labyrinth_sim.build import COUPLED, compiled, coupled_axes, own_inertia
from labyrinth_sim.model import load_model


@pytest.mark.study
def test_friction_in_one_joint_of_an_arm_is_named(tmp_path: Path) -> None:
    """Three joints; six take minutes, which the benchmark takes."""
    model = arm(tmp_path, 3)
    assert coupled_axes(model) == [("a0",), ("a1", "a2")]
    named = timed_diagnosis(model, motion(model, 2.0), ("coulomb_friction", "gravity_load")).named
    assert named == (HIDDEN,)


def test_many_axes_that_shake_one_another_are_judged_apart_unless_an_effect_between_them_is_asked_for(
    tmp_path: Path,
) -> None:
    model = arm(tmp_path, 4)
    assert coupled_axes(model) == [("a0", "a1", "a2", "a3")]
    parts = [AxisPart((axis.name,), axis.positions, (f"drive.{axis.name}.stiffness",)) for axis in model.rig.axes]
    assert joined(model, parts) == parts
    assert joined(model, parts, ["coulomb_friction", "backlash.a1"]) == parts
    (all_of_them,) = joined(model, parts, ["cross_coupling.a1"])
    assert all_of_them.axes == ("a0", "a1", "a2", "a3")


@pytest.mark.study
def test_a_joint_is_judged_while_the_others_move_as_they_were_measured(tmp_path: Path) -> None:
    """The friction of one joint shakes the others, which lack nothing and must not be told to."""
    model = arm(tmp_path, 4)
    play = motion(model, 2.0)
    run = SearchOptions(("coulomb_friction",), 1)
    parts = axis_parts(model, [play])
    bases = fitted_bases(model, [play], parts, run, roughly=True)
    found = diagnosed(model, [play], parts, run, None, bases)
    assert [axis.part for axis in found] == parts
    assert [axis.best.effects for axis in found] == [(), (HIDDEN,), (), ()]
    assert all(axis.base.cost < 1.1 for axis in found if axis.part.axes != ("a1",))
    assert max(axis.best.cost for axis in found) < 1.1
    (note,) = [n for n in notes_of(model, parts, parts, [play], found) if "moved as they were measured" in n]
    assert "(cross_coupling, supply_sag)" in note
    among = bases.among(model, [play], found[1].part)
    _, curves = free_curves(found[1].search, found[1].base, *among, found[1].part)
    assert curves[0].cost < 1.1 < 20.0 < found[1].base.cost


def test_only_axes_that_share_a_hundredth_of_their_inertia_are_taken_together(tmp_path: Path) -> None:
    assert coupled_axes(load_model("two_link_arm")) == [("shoulder", "elbow")]
    arm(tmp_path, JOINTS)
    file = tmp_path / "arm.xml"
    text, last = file.read_text(), 'name="joint_5" axis="1 0 0" armature='
    assert text.count(f'{last}"0.02"') == 1
    for armature, alone in (("2.0", False), ("50.0", True)):  # of its own gear, which the others do not feel
        file.write_text(text.replace(f'{last}"0.02"', f'{last}"{armature}"'))
        share = shared(file)
        assert 0.001 < share < COUPLED if alone else share > COUPLED
        groups = coupled_axes(load_model(tmp_path / "model.yaml"))
        assert groups == ([("a0", "a1", "a2", "a3", "a4"), ("a5",)] if alone else [tuple(f"a{i}" for i in range(6))])


def shared(file: Path) -> float:
    """Largest share of the last joint's inertia with another's, with the arm stretched out."""
    mj = mujoco.MjModel.from_xml_path(str(file))
    data, whole = mujoco.MjData(mj), np.zeros((mj.nv, mj.nv))
    mujoco.mj_forward(mj, data)
    mujoco.mj_fullM(mj, data, whole)
    own = np.sqrt(np.diag(whole))
    return float(np.abs(whole[-1, :-1] / own[-1] / own[:-1]).max())


def test_a_joint_has_the_inertia_that_a_torque_feels_while_the_others_are_free(tmp_path: Path) -> None:
    model = arm(tmp_path, 3)
    mj = compiled(model, with_ball=False).mj
    felt = []
    for angle in (0.0, 0.3, 1.0):
        accelerations = []
        for torque in (0.0, 0.1):
            data = mujoco.MjData(mj)
            data.qpos[:] = angle
            data.qfrc_applied[1] = torque
            mujoco.mj_forward(mj, data)
            accelerations.append(data.qacc[1])
        felt.append(0.1 / (accelerations[1] - accelerations[0]))
    assert own_inertia(model, "a1") == pytest.approx(min(felt), rel=1e-6)
    assert min(felt) < 0.98 * max(felt)
