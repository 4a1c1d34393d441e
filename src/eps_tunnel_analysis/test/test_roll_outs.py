# SPDX-License-Identifier: Apache-2.0
"""The pose at the start, the drive's own ticks, what is stated, and how long the steps of a roll-out may be."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import WHOLE_DELAY as TRUTH
from fit_cases import made_by, part_search, plays, refit, start, step

from eps_tunnel_analysis.diagnose import evidence as evidence_module
from eps_tunnel_analysis.diagnose.roll_outs import STEPS_LONGER
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.stated import strain_of
from eps_tunnel_analysis.recorded_play import Play


@pytest.fixture(scope="module")
def recorded() -> list[Play]:
    return plays((3.0, -2.0), TRUTH)


def test_a_pose_that_was_read_wrongly_at_the_start_is_put_right_as_far_as_the_sensors_allow() -> None:
    # Stiction holds the axis wherever it starts.
    stuck = start().with_values(TRUTH).with_effect("coulomb_friction", "x", {"torque": 1.0}, "test")
    search = part_search(stuck, [Play("stuck", made_by(stuck, step(0.1, samples=500)))])
    exact = search.levels["exact"]
    noise = exact.start_noise(0, "motor_x")
    begun = exact.initial[0]["motor_x"][0]
    search.levels = {level: e.started([{"motor_x": 1.5 * noise, "board_x": 1.5 * noise}]) for level, e in
                     search.levels.items()}  # fmt: skip
    search.settle_start(refit(search, (), 1.0), [["motor_x"], ["board_x"]])
    settled = [e.initial[0]["motor_x"][0] for e in search.levels.values()]
    assert abs(settled[0]) < 0.5 * noise < abs(begun + 1.5 * noise)
    assert settled == [settled[0]] * len(settled)
    far = [{"motor_x": 50.0 * noise, "board_x": 50.0 * noise}]
    search.levels = {level: e.started(far) for level, e in search.levels.items()}
    search.settle_start(refit(search, (), 1.0), [["motor_x"], ["board_x"]])
    assert search.levels["exact"].initial[0]["motor_x"][0] > 40.0 * noise  # that is no noise of a sensor


def test_the_ticks_of_a_drive_count_by_what_they_do_to_the_motion(recorded: list[Play]) -> None:
    fine = part_search(start().with_values(TRUTH), recorded)
    tick = 0.004
    coarse = part_search(start().with_values({**TRUTH, "drive.x.feedback_tick": tick}), recorded)
    more = np.sqrt(coarse.scale**2 - fine.scale**2)
    assert (more > 0.0).all()
    assert more.max() < tick  # for the motor filters them
    coarse.see_ticks(coarse.start)
    assert np.sqrt(coarse.scale**2 - fine.scale**2) == pytest.approx(more, rel=1e-9)  # and they count once


@pytest.mark.parametrize(("apart", "agrees"), [(0.0, True), (0.5, False)])
def test_ticks_count_less_the_more_the_rig_s_do_the_same_as_the_model_s(
    recorded: list[Play], apart: float, agrees: bool
) -> None:
    """The rig's own ticks lie where the model's do, or half of one beside them."""
    tick = 0.004
    coarse = start().with_values({**TRUTH, "drive.x.feedback_tick": tick})
    made = made_by(coarse, np.asarray(recorded[0].trials.commands[0]) + apart * tick)
    beside = apart * tick * np.array([unit == "rad" for unit in made.units])
    back = replace(made, commands=made.commands - apart * tick, values=made.values - beside)
    search = part_search(coarse, [Play("ticks", back)])
    here = search.at(search.start, refit(search, (), 1.0))
    found = search.ticks_agree(here)
    motor = search.evidence.signals.index("motor_x")
    assert (found[motor] > 0.5) == agrees
    before = search.scale[search.signal == motor].copy()
    search.see_ticks(search.start, found)
    assert bool((search.scale[search.signal == motor] < 0.8 * before).all()) == agrees


def test_a_value_that_is_stated_is_left_only_for_a_reason(recorded: list[Play]) -> None:
    model = start().with_values(TRUTH).with_effect("viscous_friction", "x", {"damping": 0.05}, "data sheet")
    search = part_search(model, recorded)
    column = search.library.base.index("viscous_friction.x.damping")
    moved = search.start.copy()
    moved[column] *= 1.0 + SETTINGS.loose
    one_off = float(strain_of(np.ones(1))[0])
    assert search.strain(search.start) == 0.0
    assert search.strain(moved) == pytest.approx(one_off)
    moved[search.library.base.index("drive.x.p")] *= 2.0  # a gain is anybody's guess
    assert search.strain(moved) == pytest.approx(one_off)


@pytest.mark.parametrize(("share", "shorter"), [(1.0, False), (0.003, True)])
def test_steps_are_halved_until_the_answer_stands(recorded: list[Play], share: float, shorter: bool) -> None:
    search = part_search(start().with_values(TRUTH), recorded)
    search.scale = share * search.scale  # a smaller floor sees more of what steps get wrong
    there = search.levels["exact"](search.start[None])
    search.levels = {level: e.less(there[0]) for level, e in search.levels.items()}  # nothing else is left
    steps = search.levels["fine"].shortest
    assert search.refine_at(search.start) is shorter
    fine, exact = search.levels["fine"].shortest, search.levels["exact"].shortest
    assert (exact < steps) is (exact < fine) is shorter  # descents stay faster
    assert fine <= STEPS_LONGER * exact


@pytest.mark.parametrize("alike", [True, False])
def test_steps_are_halved_where_what_they_get_wrong_adds_to_what_is_left(recorded: list[Play], alike: bool) -> None:
    """A tenth of the floor changes the floors that are left by a quarter of one, if it looks like what is left."""
    search = part_search(start().with_values(TRUTH), recorded)
    exact = search.levels["exact"]
    there = exact(search.start[None])[0]
    wrong = exact.finer()(search.start[None])[0] - there
    search.scale = search.scale * float(np.sqrt(np.mean((wrong[search.used] / search.scale) ** 2))) / 0.1
    signs = 1.0 if alike else np.where(np.random.default_rng(1).random(len(wrong)) < 0.5, -1.0, 1.0)
    left = -15.0 * signs * wrong  # two floors and a quarter
    search.levels = {level: e.less(there - left) for level, e in search.levels.items()}
    assert search.refine_at(search.start) is alike


@pytest.mark.parametrize(("width", "steps"), [(0.01, 2), (0.0100006, 2), (0.0104, 2), (0.0107, 3), (0.004, 1)])
def test_jitter_of_the_stamps_does_not_shorten_the_steps(width: float, steps: int) -> None:
    assert evidence_module._even(width, 0.005) == pytest.approx(width / steps)
