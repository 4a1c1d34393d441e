# SPDX-License-Identifier: Apache-2.0
"""Cases on the emulated testbed: one rig, whose physics shares no line with the effects, at three fixed strengths.

Single effects (weak, medium, strong), pairs of strong ones, nothing, and things outside the library; always with wrong
drive values, noise, quantisation and jittering stamps; 5 trials of excite_12s.
"""

from dataclasses import replace

import numpy as np
from drawn_rigs.reading import Model, Play
from numpy.typing import NDArray

from eps_tunnel_analysis.sequence import Command
from labyrinth_hw.testbed.hidden import EFFECTS, SENSOR_SIGNALS, STRENGTHS, Hidden, TestbedConfig, hide, load_testbed
from labyrinth_hw.testbed.offline import Run, run_offline
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

TRIALS = 5
RATE = 100.0
SIGNALS = ("motor_x", "motor_y", "board_x", "board_y", "motor_x_effort", "motor_y_effort")
STALL = 6.0  # N m, the data sheet of the servo that the testbed emulates
KINDS = {"single": 0.55, "pair": 0.15, "healthy": 0.15, "outside": 0.15}


def draw(seed: int) -> tuple[str, tuple[Hidden, ...], Model]:
    """Kind of case, what is hidden, and a model with wrong drive values."""
    rng = np.random.default_rng([seed, 5])
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    known = [n for n, e in EFFECTS.items() if e.known and not e.ball]
    outside = [n for n, e in EFFECTS.items() if not e.known]
    hidden: tuple[Hidden, ...] = ()
    if kind == "single":
        hidden = (_hidden(rng, str(rng.choice(known)), str(rng.choice(STRENGTHS))),)
    elif kind == "pair":
        names = rng.choice(known, 2, replace=False)
        hidden = tuple(_hidden(rng, str(n), "strong") for n in names)
    elif kind == "outside":
        hidden = (_hidden(rng, str(rng.choice(outside)), str(rng.choice(STRENGTHS[1:]))),)
    wrong = {}
    for axis in "xy":
        wrong[f"drive.{axis}.p"] = rng.uniform(15.0, 25.0)
        wrong[f"drive.{axis}.d"] = rng.uniform(-2.0, 2.0)
        wrong[f"drive.{axis}.delay"] = rng.uniform(0.01, 0.045)
        wrong[f"drive.{axis}.torque"] = STALL * rng.uniform(0.9, 1.1)
    return kind, hidden, load_model("labyrinth_manual").with_values(wrong, "wrong on purpose")


def _hidden(rng: np.random.Generator, name: str, strength: str) -> Hidden:
    axis = str(rng.choice(SENSOR_SIGNALS if EFFECTS[name].sensor else ("x", "y")))
    return hide(name, axis, strength, sign=int(rng.choice([-1, 1])))


def truth_of(kind: str, hidden: tuple[Hidden, ...]) -> str:
    """The hypothesis that is true, as a verdict's set names it."""
    if kind == "outside":
        return "unknown"
    return " + ".join(sorted(item.name for item in hidden)) or "none"


def rig(hidden: tuple[Hidden, ...]) -> TestbedConfig:
    """The healthy rig with these things wrong."""
    healthy = load_testbed("healthy")
    reality = healthy.reality
    for item in hidden:
        reality = item.applied(reality)
    return replace(healthy, reality=reality, hidden=hidden)


def play(config: TestbedConfig, command: Command, seed: int) -> Play:
    """A command played on an emulated rig, brought onto the grid as bags are."""
    times, targets = command.sample(RATE)
    run = run_offline(config, times, targets, TRIALS, seed)
    values = np.stack([_on_grid(run, i, times) for i in range(TRIALS)])
    commands = np.tile(targets, (TRIALS, 1, 1))
    trials = Trials(times, SIGNALS, ("rad",) * 4 + ("N m",) * 2, values, ("motor_x", "motor_y"), commands)
    return Play(command.name, trials)


def _on_grid(run: Run, trial: int, times: NDArray[np.float64]) -> NDArray[np.float64]:
    raw = np.concatenate([run.motor[trial], run.board[trial], run.effort[trial]], axis=1)
    return np.column_stack([np.interp(times, run.stamps[trial], column) for column in raw.T])
