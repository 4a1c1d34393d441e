# SPDX-License-Identifier: Apache-2.0
"""The rigs that the benchmark of the diagnosis draws: their physics against MuJoCo's, their effects, their files."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import counting  # noqa: E402
from drawn_rigs import cases, files, reading  # noqa: E402
from drawn_rigs.commands import STYLES, person  # noqa: E402
from drawn_rigs.effects import CONTAINED_BY, FORMS, forms_of  # noqa: E402
from drawn_rigs.physics import Goals, Physics, play  # noqa: E402
from drawn_rigs.reality import Plan, clean, record  # noqa: E402
from drawn_rigs.rigs import LAWS, PLANTS, draw_rig  # noqa: E402

from labyrinth_sim.effect import effects  # noqa: E402
from labyrinth_sim.model import load_model  # noqa: E402
from labyrinth_sim.simulate import simulate_batch  # noqa: E402

RATE = 100.0


def rig_of(kind, law, seed=3, exact=True):
    return draw_rig(np.random.default_rng(seed), kind, law, exact)


def plan_of(rig, style="excite", seconds=3.0, seed=5):
    times = np.arange(0.0, seconds, 1.0 / RATE)
    targets = STYLES[style](np.random.default_rng(seed), times, np.array(rig.reach))
    return Plan(times, targets, seconds - 0.05, RATE)


@pytest.mark.parametrize("kind", list(PLANTS))
@pytest.mark.parametrize("law", LAWS)
def test_a_healthy_rig_moves_as_mujoco_says(kind, law, tmp_path):
    """Stated values true, no torque-speed line, quick firmware: two physics, the same equations, no refit."""
    rig = rig_of(kind, law)
    physics = replace(rig.reality.physics, period=1e-4)  # MuJoCo's drives are as good as continuous
    physics = Physics(physics.rig, tuple({**a, "d": 0.0} if law == "velocity_pid" else a for a in physics.axes), 1e-4)
    rig = replace(rig, reality=replace(rig.reality, physics=physics))
    plan = plan_of(rig, "person", 2.0)
    positions = [name for axis in range(len(rig.axes)) for name in rig.positions(axis)]
    bare = {name: replace(sensor, noise=0.0, tick=0.0) for name, sensor in rig.reality.sensors.items()}
    seen = clean(replace(rig.reality, sensors=bare), plan)
    model = load_model(files.write_rig(tmp_path, rig, RATE))
    if law == "velocity_pid":
        model = model.with_values({f"drive.{axis}.d": 0.0 for axis in rig.axes})
    samples = len(seen[positions[0]])
    first = {name: np.array([seen[name][0]]) for name in positions}
    result = simulate_batch(
        model, (), np.empty((1, 0)), plan.times[:samples], plan.targets[None, :samples], first, signals=positions,
        timestep=2e-4, nthread=1,
    )  # fmt: skip
    apart = result.values[0, 0] - np.stack([seen[name] for name in positions], axis=1)
    assert np.sqrt(np.mean(apart**2)) < 1e-4
    assert np.sqrt(np.mean(seen[positions[0]] ** 2)) > 0.1 * rig.reach[0]


def test_friction_holds_exactly_and_lets_go_at_its_torque():
    """A pendulum let go at an angle stays there for ever while friction can hold it, and falls where not."""
    axis = {"inertia": 0.01, "below": 0.05, "armature": 0.002, "law": 1.0, "p": 0.0, "d": 0.0}
    holding = 0.05 * 9.81 * np.sin(0.5)
    start = Goals(np.zeros((1, 1)), np.full((1, 1), 0.5), np.array([0.5]))
    held = play(Physics({}, ({**axis, "coulomb": holding * 1.001},)), start, 5.0)
    assert np.abs(held.motor - 0.5).max() < 1e-12
    falls = play(Physics({}, ({**axis, "coulomb": holding * 0.9},)), start, 5.0)
    assert 0.5 - falls.motor[-1, 0] > 0.05


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    "gradual",
    [
        {"friction_form": 1, "smooth_speed": 3e-3},
        {"friction_form": 2, "bristle": 2e3, "bristle_damping": 5.0},
        {"friction_form": 3, "bristle": 2e3},
    ],
    ids=["tanh", "LuGre", "Dahl"],
)
def test_friction_that_sets_in_gradually_moves_coupled_joints_as_sharp_friction_does(axis, gradual):
    rig = rig_of("two_link_arm", "torque_pd")
    plan = plan_of(rig, "person", 2.0)
    bare = {name: replace(sensor, noise=0.0, tick=0.0) for name, sensor in rig.reality.sensors.items()}
    smooth = replace(rig.reality, sensors=bare)
    none, sharp, slow = (
        clean(smooth.with_axis(axis, **{"coulomb": torque} | more), plan)
        for torque, more in ((0.0, {"friction_form": 0}), (0.4, {"friction_form": 0}), (0.4, gradual))
    )
    for joint in range(2):
        name = rig.positions(joint)[0]
        moved = np.sqrt(np.mean((sharp[name] - none[name]) ** 2))
        assert np.sqrt(np.mean((slow[name] - sharp[name]) ** 2)) < 0.25 * moved, name


def test_the_physics_imports_nothing_of_the_model():
    found = subprocess.run(
        [sys.executable, "-c",
         "import sys, drawn_rigs.reality, drawn_rigs.rigs, drawn_rigs.effects, drawn_rigs.commands\n"
         "print([m for m in sys.modules if m.split('.')[0] in ('labyrinth_sim', 'eps_tunnel_analysis', 'mujoco')])"],
        cwd=BENCHMARKS, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert found.stdout.strip() == "[]"


def test_every_effect_of_the_library_has_a_form_and_every_name_exists():
    known = {form.effect for form in FORMS if not form.outside}
    assert known == set(reading.library_names())
    assert not {form.effect for form in FORMS if form.outside} & set(effects())
    for one, others in CONTAINED_BY.items():
        assert {one, *others} <= known


@pytest.mark.parametrize(
    ("kind", "law"), [("labyrinth", "velocity_pid"), ("two_link_arm", "torque_pd"), ("pendulum", "pwm_servo")]
)
def test_every_form_shows_more_the_stronger_it_is(kind, law):
    rig = rig_of(kind, law, seed=11, exact=False)
    plan = plan_of(rig)
    weakly = []
    for outside in (False, True):
        for form, axis, place in forms_of(rig, outside):
            if axis or (form.sensor and place != rig.positions(0)[0]):
                continue
            before = form.before(rig.reality, axis) if form.before else rig.reality
            still = clean(before, plan)
            sizes = []
            for strength in (form.low, form.high):
                moved = clean(form.apply(rig, before, axis, place, strength, np.full(5, 0.5)), plan)
                sizes.append(max(np.std(moved[n] - still[n]) + abs(np.mean(moved[n] - still[n])) for n in still))
            if not sizes[0] < sizes[1]:
                weakly.append((form.effect, form.name, sizes))
    assert not weakly


@pytest.mark.parametrize(
    ("effect", "sign", "way"),
    [
        ("gravity_load", 1.0, 1.0),  # pulled to the side where the mass is
        ("gravity_load", -1.0, -1.0),
        ("gain_error", 1.0, 1.0),  # further than asked for
        ("gain_error", -1.0, -1.0),
        ("return_spring", 1.0, -1.0),  # short of it
        ("sensor_bias", 1.0, 1.0),
        ("sensor_gain", -1.0, -1.0),
        ("coulomb_friction", 1.0, -1.0),
        ("dead_band", 1.0, -1.0),
        ("command_delay", 1.0, -1.0),
        ("rate_limit", 1.0, -1.0),
        ("viscous_friction", 1.0, -1.0),
        ("torque_saturation", 1.0, -1.0),
    ],
)
def test_an_effect_moves_the_axis_its_own_way(effect, sign, way):
    """On a step from zero, the mean of the angle over it is larger or smaller."""
    rig = rig_of("labyrinth", "torque_pd")
    rig = replace(rig, friction=())
    times = np.arange(0.0, 1.0, 0.01)
    targets = np.column_stack([np.where(times > 0.2, 0.06, 0.0), np.zeros_like(times)])
    plan = Plan(times, targets, 0.9, RATE)
    for form, axis, place in forms_of(rig, outside=False):
        if form.effect == effect and axis == 0:
            before = form.before(rig.reality, axis) if form.before else rig.reality
            moved = clean(form.apply(rig, before, axis, place, sign * form.high, np.full(5, 0.5)), plan)
            signal = place if form.sensor else "board_x"
            change = float(np.mean(moved[signal] - clean(before, plan)[signal]))
            assert change * way > 1e-5, form.name


def test_a_seed_gives_the_same_case_and_another_one_another(tmp_path):
    one, same = (cases.draw(5, tmp_path / name, "pendulum", "single") for name in ("a", "b"))
    other = cases.draw(9, tmp_path / "c", "pendulum", "single")
    assert one.to_json() == same.to_json() != other.to_json()
    assert one.model.read_text(encoding="utf-8") == same.model.read_text(encoding="utf-8")
    plays, again = (reading.loaded(case.model, case.bags)[1] for case in (one, same))
    for p, q in zip(plays, again, strict=True):
        assert np.array_equal(p.trials.values, q.trials.values, equal_nan=True)


def test_what_is_hidden_shows_as_it_was_meant_to(tmp_path):
    """The visibility of a case is that of the rig that was recorded, and its bags hold the stamps as they were."""
    case = cases.draw(3, tmp_path, "pendulum", "single")
    assert case.truth == case.hidden[0].name and case.hidden[0].visibility > 0.1
    assert case.hidden[0].deviation >= case.hidden[0].visibility * 0.99
    rig = rig_of("pendulum", "torque_pd", exact=False)
    plan = replace(plan_of(rig), send_jitter=0.001, stamp_jitter=0.0003)
    trials = record(rig.reality, plan, 2, seed=1)
    bags = files.write_bags(tmp_path, rig, "played", trials, plan.seconds, marked=True)
    (read,) = reading.read_all(bags)
    stamps = read.stamps("/real/joint_states")
    begin = 1.0 + files.EPOCH
    first = stamps[: len(trials[0].stamps)] * 1e-9 - begin
    assert np.allclose(first, trials[0].stamps, atol=1e-6)
    assert np.std(np.diff(first)) > 5e-4
    column = read.topics["/real/joint_states"].columns["pendulum.position"][: len(first)]
    assert np.array_equal(column, trials[0].readings["pendulum"])


@pytest.mark.parametrize("strength", [0.005, 0.02, 1.0])
def test_of_a_profile_only_the_acceleration_shows(strength):
    """In a step from end to end, which reaches the highest speed."""
    rig = rig_of("labyrinth", "torque_pd")
    (form,) = (form for form in FORMS if form.effect == "motion_profile")
    times = np.arange(0.0, 2.0, 0.01)
    targets = np.column_stack([np.where(times > 0.2, 1.0, -1.0) * rig.reach[0], np.zeros_like(times)])
    plan = Plan(times, targets, 1.9, RATE)
    profile = form.apply(rig, rig.reality, 0, "x", strength, np.zeros(5))
    apart = clean(profile, plan)["motor_x"] - clean(profile.with_axis(0, rate=1e9), plan)["motor_x"]
    assert np.max(np.abs(apart)) < 1e-6


def test_what_other_values_of_the_drive_make_up_for_is_not_visible(tmp_path):
    """A profile of a high acceleration is a later command and a harder drive; slopes at the true values miss that."""
    (hidden,) = cases.draw(690001, tmp_path, "pendulum", "single", "motion_profile").hidden
    assert hidden.first_order > 5.0 > 1.0 > hidden.visibility


@pytest.mark.study
def test_what_makes_trials_differ_is_seen_above_their_own_floor(tmp_path):
    (late,) = cases.draw(790011, tmp_path, "pendulum", "left_out", "command_delay").hidden
    assert late.form == "jittering" and late.first_order > 5.0 > 2.5 > late.visibility


def test_bristles_that_stand_for_friction_are_right_under_both_names(tmp_path):
    hidden = cases.Hidden("coulomb_friction", "x", "lugre", 0.1, 9.0, 8.0, 8.0, also=("lugre_friction",))
    other = cases.Hidden("backlash", "y", "contact", 0.1, 9.0, 8.0, 8.0)
    case = cases.Case(1, "pair", "labyrinth", "", (hidden, other), None, tmp_path, (), (), 100.0, 1)
    assert case.truth == "backlash.y + coulomb_friction.x" and case.as_true == ("backlash.y + lugre_friction.x",)
    assert all(set(form.also) <= set(reading.library_names()) for form in FORMS)


def test_one_supply_is_right_at_every_axis(tmp_path):
    """In a record, too, of which only the sag shows."""
    sag = cases.Hidden("supply_sag", "elbow", "resistor", 0.1, 9.0, 8.0, 8.0, elsewhere=("shoulder",))
    faint = cases.Hidden("backlash", "elbow", "contact", 0.1, 9.0, 0.1, 8.0)
    case = cases.Case(1, "pair", "two_link_arm", "", (sag, faint), None, tmp_path, (), (), 100.0, 1)
    assert case.truth == "backlash.elbow + supply_sag.elbow"
    both = "supply_sag.elbow + supply_sag.shoulder"
    assert case.as_true == ("backlash.elbow + supply_sag.shoulder", f"backlash.elbow + {both}")
    record = case.to_json() | {"visibility": 8.0}
    right = [name for name in (sag.name, "supply_sag.shoulder", both, faint.name) if counting.is_true(record, name)]
    assert right == ["supply_sag.elbow", "supply_sag.shoulder", both]


def test_left_out_is_what_contains_it_too(tmp_path):
    case = cases.draw(5, tmp_path, "pendulum", "left_out")
    gone = set(reading.library_names()) - set(case.only or ())
    assert case.truth == "unknown" and case.hidden[0].effect in gone
    assert gone == {case.hidden[0].effect, *CONTAINED_BY.get(case.hidden[0].effect, ())}


def test_a_person_moves_within_reach_and_from_zero():
    time = np.arange(0.0, 8.0, 0.01)
    moved = person(np.random.default_rng(0), time, np.array([0.5, 0.2]))
    assert np.all(np.abs(moved).max(axis=0) <= [0.5, 0.2]) and np.allclose(moved[0], 0.0)
