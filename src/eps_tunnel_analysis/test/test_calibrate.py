# SPDX-License-Identifier: Apache-2.0
"""Calibration of a real model on plays of known origin: what is free, what is held out, where it is computed."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import FREE, TRUTH, made_by, plays, start, step

from eps_tunnel_analysis.calibration.calibrate import (
    CalibrationResult,
    Settings,
    calibrate,
    calibrate_model,
    judge,
    judge_rig,
)
from eps_tunnel_analysis.fit.methods import EvolutionStrategy
from eps_tunnel_analysis.fit.problem import Objective, by_axis, copied, default_free, free_parameters
from eps_tunnel_analysis.inputs import hold_out
from eps_tunnel_analysis.outputs import shown_share
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.terminal import print_calibration, text_of
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

SIGNALS = ("motor_x",)


def test_gauss_newton_finds_the_values_that_made_the_data_on_a_command_it_never_saw() -> None:
    fit = calibrate(start(), FREE, plays(), Settings(signals=SIGNALS, held_out=(2,)))
    for p in fit.parameters:
        if p.name != "drive.x.d":
            assert abs(p.value - TRUTH[p.name]) <= max(0.02 * abs(TRUTH[p.name]), 2 * p.half_width), p
    assert fit.held_out_after < 0.05 * fit.held_out_before
    assert fit.held_out_plays == ("+1deg",)
    assert fit.converged


@pytest.mark.study
def test_the_interval_of_d_holds_the_value_that_made_the_data() -> None:
    fit = calibrate(start(), FREE, plays(), Settings(signals=SIGNALS, held_out=(2,)))
    (d,) = (p for p in fit.parameters if p.name == "drive.x.d")
    assert abs(d.value - TRUTH["drive.x.d"]) <= 2 * d.half_width


@pytest.mark.study
def test_what_is_held_out_does_not_touch_the_fit() -> None:
    """The play held out was made by other values, so that a fit that saw it would go elsewhere."""
    other = plays((5.0,), {**TRUTH, "drive.x.p": 6.0, "drive.x.delay": 0.01})
    settings = Settings(signals=SIGNALS, budget=60)
    alone = calibrate(start(), FREE, plays((-3.0, 2.0)), settings)
    fit = calibrate(start(), FREE, [*plays((-3.0, 2.0)), *other], replace(settings, held_out=(2,)))
    assert fit.parameters == alone.parameters
    assert fit.after == alone.after
    assert (fit.fitted_plays, fit.held_out_plays) == (("-3deg", "+2deg"), ("+5deg",))
    (error,) = judge(start().with_values(fit.values), other, SIGNALS)
    assert fit.held_out_after == pytest.approx(error.error) and error.error > 5 * fit.after


def test_a_score_is_the_mean_distance_and_the_shares_within_the_tunnel() -> None:
    """A servo at rest at 0, and trials whose mean lies beside it: a tunnel of -2 to +1 mrad, left to either side."""
    off = np.repeat([0.0, 0.9, 1.1, 1.9, -1.9, -2.1, 2.1, -3.9], 20)  # simulated less measured, mrad
    values = 1e-3 * (np.array([-2.0, 1.0, 1.0])[:, None] - off)[:, :, None]
    time = np.arange(len(off)) * 0.01
    still = Trials(time, SIGNALS, ("rad",), values, ("motor_x", "motor_y"), np.zeros((3, len(off), 2)))
    (score,) = judge(start(), [Play("still", still)], SIGNALS, ks=(1.0, 2.0))
    assert score.error == pytest.approx(1e-3 * np.abs(off).mean())
    assert score.alikeness == {1.0: 3 / 8, 2.0: 7 / 8}  # -2 <= off <= 1 and -4 <= off <= 2


def test_the_rig_against_itself_counts_the_samples_of_every_command_with_enough_trials() -> None:
    """Three trials at -1, 0 and 1 mrad for 4 s, then apart no more: each outer one leaves the others' tunnel."""
    apart = 1e-3 * np.array([-1.0, 0.0, 1.0])[:, None, None]
    commands = ("motor_x", "motor_y")

    def still(trials: int, samples: int, spread: float) -> Play:
        values = spread * apart[:trials] * np.ones((1, samples, 1))
        time = np.arange(samples) * 0.01
        return Play("still", Trials(time, SIGNALS, ("rad",), values, commands, np.zeros((trials, samples, 2))))

    wide, narrow, single = still(3, 400, 1.0), still(3, 100, 0.0), still(1, 100, 1.0)
    assert judge_rig(start(), [wide], SIGNALS, ks=(1.0, 4.0)) == {"motor_x": {1.0: pytest.approx(1 / 3), 4.0: 1.0}}
    found = judge_rig(start(), [wide, narrow, single], SIGNALS, ks=(1.0,))
    assert found == {"motor_x": {1.0: pytest.approx((400 / 3 + 100) / 500)}}
    assert judge_rig(start(), [single], SIGNALS) == {}


def test_a_fits_tables_have_the_rig_against_itself_below_each_signal() -> None:
    fitted, held = plays((2.0, -3.0)), plays((1.0,))
    scores = [judge(start(), some, SIGNALS) for some in (fitted, fitted, held, held)]
    rig = [judge_rig(start(), some, SIGNALS) for some in (fitted, held)]
    result = CalibrationResult(start(), (), (), *scores, *rig)
    printed = text_of(lambda out: print_calibration(result, (), out), width=200).split("Held-out commands")
    for text, itself in zip(printed, rig, strict=True):
        row = next(line for line in text.splitlines() if "rig against itself" in line)
        assert [part.strip() for part in row.split("|")[4:-1]] == [shown_share(v) for v in itself["motor_x"].values()]


@pytest.mark.study
def test_a_recording_that_a_fit_made_worse_is_told_though_the_mean_fell() -> None:
    """The one held out was made by other values, which the start has already."""
    odd = {**TRUTH, "drive.x.p": 12.0}
    several = [*plays((-3.0, 2.0, 4.0)), *plays((5.0,), odd)]
    settings = Settings(signals=SIGNALS, held_out=(3,), budget=60)
    result = calibrate_model(start().with_values(odd), several, ("drive.x.p",), settings)
    worst, *others = result.plays
    assert (worst.name, worst.held_out, worst.unit) == ("+5deg", True, "rad")
    assert {p.name for p in others} == {"-3deg", "+2deg", "+4deg"} and all(p.change < 0.2 for p in others)
    for model, error in ((start().with_values(odd), worst.before), (result.model, worst.after)):
        assert judge(model, several[3:], SIGNALS)[0].error == pytest.approx(error)
    assert result.warnings[0].startswith("Worse than before on 1 of 4 recordings: +5deg (held out), ")
    printed = text_of(lambda out: print_calibration(result, (), out), width=160)
    assert "Error of each recording" in printed and "Warning: Worse than before" in printed
    steady = calibrate_model(start(), several[:3], ("drive.x.p",), replace(settings, held_out=()))
    assert not any("Worse" in text for text in steady.warnings)


def test_what_is_free_by_default_is_what_the_drives_and_effects_say() -> None:
    model = start().with_effect("backlash", "y")
    names = default_free(model)
    assert set(names) == {
        *(f"drive.{axis}.{name}" for axis in "xy" for name in ("p", "i", "d", "delay")), "backlash.y.width",
        "backlash.y.hold",
    }  # fmt: skip
    assert free_parameters(model, ["backlash.*", "drive.x.p"]) == ("drive.x.p", "backlash.y.width", "backlash.y.hold")
    with pytest.raises(InputError, match="Did you mean 'drive"):
        free_parameters(model, ["drive.x.q"])


def test_what_only_an_effort_tells_of_a_drive_is_free_where_none_is_compared() -> None:
    model = load_model("pendulum")
    (axis,) = model.rig.axes
    assert model.drives[axis.name].kind.identified_by_effort == ("duty_gain",)
    effort = replace(axis.measured[0], signal="duty", quantity="torque")
    model = replace(model, rig=replace(model.rig, axes=(replace(axis, measured=(*axis.measured, effort)),)))
    gain = f"drive.{axis.name}.duty_gain"
    assert gain in default_free(model, signals=["pendulum"])
    assert gain not in default_free(model, signals=["pendulum", "duty"])


def test_every_default_free_parameter_of_every_model_exists() -> None:
    for name in ("labyrinth", "horn", "pendulum", "two_link_arm"):
        model = load_model(name)
        assert set(default_free(model)) <= set(model.parameters()), name


def test_an_axis_is_fitted_to_its_own_signals_and_to_the_plays_that_move_it() -> None:
    both = [*plays((2.0, -3.0)), *plays((1.0,), axis=1)]
    x, y = by_axis(start(), default_free(start()), both, None)
    assert (x.axis, x.plays, x.signals) == ("x", (0, 1), ("motor_x", "board_x"))
    assert (y.axis, y.plays, y.signals) == ("y", (2,), ("motor_y", "board_y"))
    assert all(".x." in name for name in x.free)


def test_a_calibration_axis_by_axis_leaves_the_other_axis_alone() -> None:
    recorded = [*plays((2.0, -3.0)), *plays((1.0,), axis=1)]
    settings = Settings(method=EvolutionStrategy(generations=1, offspring=4), seed=1)
    result = calibrate_model(start(), recorded, default_free(start()), settings, axis_by_axis=True)
    assert [part.axis for part in result.parts] == ["x", "y"]
    assert [fit.fitted_plays for fit in result.fits] == [("+2deg", "-3deg"), ("+1deg",)]
    assert result.itself == judge_rig(start(), recorded) and not result.held_out_itself
    for fit in result.fits:
        for name, value in fit.values.items():
            assert result.model.values()[name] == value


def test_whole_commands_are_held_out_and_always_the_same_ones() -> None:
    many = [Play(str(i), play.trials) for i, play in enumerate(plays((1.0,)) * 10)]
    assert len(hold_out(many, None, 0)) == 2
    assert hold_out(many, None, 0) == hold_out(many, None, 0) != hold_out(many, None, 1)
    assert len(hold_out(many, 3, 0)) == 3
    assert len(hold_out(many, 0.05, 0)) == 1
    assert hold_out(many[:4], None, 0) == ()
    assert hold_out(many, 0, 0) == ()
    with pytest.raises(InputError, match="Cannot hold out 1 of 1"):
        hold_out(many[:1], 0.5, 0)


def test_a_budget_ends_a_fit_at_the_end_of_a_batch() -> None:
    fit = calibrate(start(), FREE, plays((3.0,)), Settings(signals=SIGNALS, budget=40))
    assert 40 <= fit.evaluations <= 40 + 33 + len(FREE) + 1
    assert fit.after <= fit.before


def test_an_interrupted_fit_keeps_the_best_so_far() -> None:
    told = []

    def stop(count: int, best: float) -> None:
        told.append(best)
        if count > 50:
            raise KeyboardInterrupt

    fit = calibrate(start(), FREE, plays((3.0,)), Settings(signals=SIGNALS), stop)
    assert fit.interrupted
    assert not fit.converged
    assert fit.after <= min(told)
    assert np.isfinite([p.half_width for p in fit.parameters]).all()
    assert "interrupted" in fit.warnings[0]


def test_a_copy_works_where_the_objective_does_and_a_worker_on_all_of_its_cores() -> None:
    objective = Objective(start(), FREE, plays((3.0,)), SIGNALS, nthread=1)
    other = copied(objective)
    assert other is not objective and other.__dict__ == objective.__dict__
    assert objective.__getstate__()["nthread"] == 0


def test_a_residual_depends_on_nothing_but_its_own_values() -> None:
    objective = Objective(start(), FREE, plays((3.0, -1.0)), SIGNALS)
    infos = start().parameters()
    low, high = (np.array([getattr(infos[n], side) for n in FREE]) for side in ("low", "high"))
    values = low + (high - low) * np.random.default_rng(0).random((13, 4))
    together = objective(values)
    for rows in ([3], [12, 0, 7], list(range(5, 13))):
        assert np.array_equal(together[rows], objective(values[rows]), equal_nan=True)


def unevenly_repeated() -> list[Play]:
    """A rig that answers large steps late and never twice alike, small ones always alike."""
    delays = {5.0: (0.026, 0.034, 0.046, 0.048, 0.049), 1.0: (0.030,) * 5}
    recorded = []
    for degrees, each in delays.items():
        runs = [
            made_by(start().with_values({**TRUTH, "drive.x.delay": d}), step(degrees), trials=1, seed=i)
            for i, d in enumerate(each)
        ]
        values = np.concatenate([run.values for run in runs])
        commands = np.concatenate([run.commands for run in runs])
        recorded.append(Play(f"{degrees:g}deg", replace(runs[0], values=values, commands=commands)))
    return recorded


@pytest.mark.study
def test_the_alikeness_is_the_better_target_where_the_rig_repeats_itself_unevenly() -> None:
    recorded = unevenly_repeated()
    scores, values = {}, {}
    for fitness in ("error", "srg"):
        free = ("drive.x.p", "drive.x.delay")
        fit = calibrate(start(), free, recorded, Settings(fitness=fitness, signals=SIGNALS))
        (scores[fitness],) = judge(start().with_values(fit.values), recorded, SIGNALS)
        values[fitness] = fit.values
    # The large steps' errors are the larger ones, so the error follows them; their tunnel is wide, so the alikeness
    # need not.
    assert abs(values["srg"]["drive.x.delay"] - 0.030) < abs(values["error"]["drive.x.delay"] - 0.030)
    assert scores["srg"].error > scores["error"].error
    for k in (1.0, 2.0, 3.0):
        assert scores["srg"].alikeness[k] > scores["error"].alikeness[k]
