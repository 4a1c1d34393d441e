# SPDX-License-Identifier: Apache-2.0
"""The default fit against the paper's evolution strategy and MuJoCo's own toolbox; the strategy's steps per second.

All on the paper's rotations, as the emulated rig of config/testbed/paper.yaml plays them: the same residuals, model and
start for all.
"""

import io
import sys
import tempfile
import time
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
from mujoco import sysid

sys.path.insert(0, str(Path(__file__).parent))
from batch import CORES, build_loop, run_loop

from eps_tunnel_analysis.calibration.calibrate import METHODS, Settings, make_problem
from eps_tunnel_analysis.fit.evaluations import Evaluations
from eps_tunnel_analysis.fit.methods import EvolutionStrategy
from eps_tunnel_analysis.fit.problem import Objective, Problem
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline
from labyrinth_sim.model import load_model
from labyrinth_sim.simulate import even_timestep
from labyrinth_sim.trials import Array, Trials

DEFAULT = Settings().method
AXES = ("x", "y")
EVERY = 4  # of the rotations
SECONDS = 1.0
TRIALS = 5
REPEATS = 5
GENERATIONS = 150
EVALUATIONS = 1 + 100 * GENERATIONS
LOOPS = 15  # runs of the C loop while the strategy runs


def measure() -> dict[str, float]:
    """`evaluations_to_es`, `fit_vs_mujoco_sysid`, `fitness_vs_mujoco_sysid`, `es_vs_limit`; each the worse axis."""
    figures: dict[str, float] = {}
    for axis in AXES:
        problem, objective = case(axis)
        figures |= {f"{key}_{axis}": value for key, value in against_es(problem, objective).items()}
        figures |= {f"{key}_{axis}": value for key, value in against_sysid(problem).items()}
    worst = {
        "evaluations_to_es": max, "fit_vs_mujoco_sysid": max, "fitness_vs_mujoco_sysid": max, "es_vs_limit": min,
    }  # fmt: skip
    return figures | {key: pick(figures[f"{key}_{axis}"] for axis in AXES) for key, pick in worst.items()}


def case(axis: str) -> tuple[Problem, Objective]:
    """P, I, D and delay of one servo, from the standard set on, to that servo's rotations."""
    testbed = load_testbed("paper")
    plays = []
    for number, command in enumerate(find_sequence(f"rotations_{axis}").commands[::EVERY]):
        _, steps = command.sample(100.0)
        held = np.vstack([command.initial, steps])[: round(SECONDS * 100) + 1]
        time_grid = np.arange(len(held)) / 100
        run = run_offline(testbed, time_grid, held, TRIALS, number)
        values = np.concatenate([run.motor, run.board], axis=2)
        signals, channels = ("motor_x", "motor_y", "board_x", "board_y"), ("motor_x", "motor_y")
        trials = Trials(time_grid, signals, ("rad",) * 4, values, channels, np.tile(held, (TRIALS, 1, 1)))
        plays.append(Play(command.name, trials))
    free = tuple(f"drive.{axis}.{name}" for name in ("p", "i", "d", "delay"))
    objective = Objective(load_model("labyrinth"), free, plays, (f"motor_{axis}",), nthread=CORES)
    return make_problem(objective, Settings()), objective


def against_es(problem: Problem, objective: Objective) -> dict[str, float]:
    """Evaluations until the default method is as good as the whole strategy ends, and the strategy's speed.

    The C loop runs now and then between two generations, so that other work on the machine meets both alike.
    """
    with tempfile.TemporaryDirectory() as folder:
        program = build_loop(Path(folder))
        ratios: list[float] = []
        since = [0, time.perf_counter()]

        def measure_speed(count: int, _: float) -> None:
            if count - since[0] < EVALUATIONS / LOOPS:
                return
            rate = (count - since[0]) * steps_of(objective) / (time.perf_counter() - since[1])
            ratios.append(rate / run_loop(program, objective.model, Path(folder)))
            since[:] = count, time.perf_counter()

        strategy = Evaluations(problem, progress=measure_speed)
        EvolutionStrategy(generations=GENERATIONS).run(strategy, np.random.default_rng(0))
    default = Evaluations(problem)
    METHODS[str(DEFAULT)]().run(default, np.random.default_rng(0))
    reached = [step.evaluations for step in default.history if step.fitness <= strategy.best_fitness]
    return {
        "es_fitness": strategy.best_fitness,
        "default_fitness": default.best_fitness,
        "evaluations_to_es": float(reached[0]) if reached else float("inf"),
        "es_vs_limit": float(np.median(ratios)),
    }


def steps_of(objective: Objective) -> float:
    """MuJoCo steps of one evaluation."""
    plays, samples, _ = objective.rollouts.commands.shape
    step = float(objective.rollouts.time[1])
    return plays * (samples - 1) * round(step / even_timestep(step, None, objective.model, False))


def against_sysid(problem: Problem) -> dict[str, float]:
    """Time and end of the default method over those of `mujoco.sysid.optimize` as it comes, taken in turns.

    Both move normalised values in [0, 1]. The toolbox minimises the sum of squares, so the fitness is compared after
    each has ended; `squares_vs_mujoco_sysid` compares its own measure.
    """

    def residual(x: Array, _: object, **__: object) -> tuple[list[Array], None, None]:
        z = np.asarray(x).reshape(problem.size, -1).T
        answers = problem.residuals(problem.from_unit(z)).T
        return [answers if np.ndim(x) > 1 else answers[:, 0]], None, None

    start = sysid.ParameterDict()
    for name, z in zip(problem.names, problem.to_unit(problem.start), strict=True):
        start.add(sysid.Parameter(name, float(z), 0.0, 1.0))
    ratios = []
    for _ in range(REPEATS):
        before = time.perf_counter()
        default = Evaluations(problem)
        METHODS[str(DEFAULT)]().run(default, np.random.default_rng(0))
        between = time.perf_counter()
        with redirect_stdout(io.StringIO()):
            _, theirs = sysid.optimize(start.copy(), residual, verbose=False)
        ratios.append((between - before) / (time.perf_counter() - between))
    ends = problem.residuals(problem.from_unit(np.vstack([default.best, theirs.x])))
    ours, other = problem.fitness(ends)
    squares = np.sum(ends**2, axis=1)
    return {
        "fit_vs_mujoco_sysid": float(np.median(ratios)),
        "fitness_vs_mujoco_sysid": float(ours / other),
        "squares_vs_mujoco_sysid": float(squares[0] / squares[1]),
    }


if __name__ == "__main__":
    for key, value in measure().items():
        print(f"{key:30s} {value:.6g}")
