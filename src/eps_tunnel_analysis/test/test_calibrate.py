# SPDX-License-Identifier: Apache-2.0
"""Calibration of a real model on plays of known origin: what is free, what is held out, where it is computed."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from fit_cases import FREE, TRUTH, made_by, plays, start, step

from eps_tunnel_analysis.fit.calibrate import Settings, calibrate
from eps_tunnel_analysis.fit.cluster import cluster
from eps_tunnel_analysis.fit.es import EvolutionStrategy
from eps_tunnel_analysis.fit.free import by_axis, default_free, free_parameters
from eps_tunnel_analysis.fit.hold_out import hold_out
from eps_tunnel_analysis.fit.judge import judge
from eps_tunnel_analysis.fit.objective import Objective
from eps_tunnel_analysis.fit.study import calibrate_model
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model

SIGNALS = ("motor_x",)


def test_gauss_newton_finds_the_values_that_made_the_data_on_a_command_it_never_saw() -> None:
    fit = calibrate(start(), FREE, plays(), Settings(signals=SIGNALS, held_out=(2,)))
    for p in fit.parameters:
        assert abs(p.value - TRUTH[p.name]) <= max(0.02 * abs(TRUTH[p.name]), 2 * p.half_width), p
    assert fit.held_out_after < 0.05 * fit.held_out_before
    assert fit.held_out_plays == ("+1deg",)
    assert fit.converged


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


def test_a_residual_depends_on_nothing_but_its_own_values() -> None:
    objective = Objective(start(), FREE, plays((3.0, -1.0)), SIGNALS)
    infos = start().parameters()
    low, high = (np.array([getattr(infos[n], side) for n in FREE]) for side in ("low", "high"))
    values = low + (high - low) * np.random.default_rng(0).random((13, 4))
    together = objective(values)
    for rows in ([3], [12, 0, 7], list(range(5, 13))):
        assert np.array_equal(together[rows], objective(values[rows]), equal_nan=True)


@pytest.fixture
def dask_cluster(tmp_path):
    """A scheduler and two worker processes; gives its address and the workers."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
             "--dashboard-address", ":0", "--scheduler-file", str(file)],
            env=env, stderr=subprocess.DEVNULL,
        )
    ]  # fmt: skip
    for name in ("one", "two"):
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(file), "--no-nanny",
                 "--nthreads", "1", "--no-dashboard", "--name", name, "--local-directory", str(tmp_path / name)],
                env=env, stderr=subprocess.DEVNULL,
            )
        )  # fmt: skip
    from distributed import Client

    deadline = time.monotonic() + 90
    while not file.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    with Client(scheduler_file=str(file), timeout=90, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=90)
        address = client.scheduler.address
    yield address, started[1:]
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.realtime
def test_a_cluster_that_loses_a_worker_gives_the_same_answer(dask_cluster) -> None:
    address, workers = dask_cluster
    recorded = plays((3.0, -2.0))
    settings = Settings(method=EvolutionStrategy(generations=6, offspring=40), seed=4, signals=SIGNALS)
    alone = calibrate(start(), FREE, recorded, settings)

    def murder(count: int, _: float) -> None:
        if count > 100 and workers[0].poll() is None:
            # Killed while the next batch is on its way, not between two.
            threading.Timer(0.02, workers[0].send_signal, [signal.SIGKILL]).start()

    with cluster(address) as spread:
        shared = calibrate(start(), FREE, recorded, replace(settings, spread=spread), murder)
    assert workers[0].wait(timeout=90) == -signal.SIGKILL
    assert shared.parameters == alone.parameters
    assert shared.history == alone.history


def test_a_scheduler_that_is_not_there_is_told() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="nobody answers"), cluster("tcp://127.0.0.1:9", timeout=0.5):
        pass


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
