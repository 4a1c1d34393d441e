# SPDX-License-Identifier: Apache-2.0
"""Seconds of a diagnosis over those of 1,000 bare roll-outs of the same play in the C loop, on as many cores.

Ten fixed cases on the emulated testbed: five trials of excite_12s, the whole library. The ratio is the product of how
many thousand roll-outs a diagnosis takes and of what one of them costs, in bare ones.
"""

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
from batch import build_loop, run_loop
from testbed_cases import draw, play, rig

from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.hidden import hide
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import even_timestep

ROLLOUTS = 1000
SEED = 9500  # of the first case's noise and wrong drive values; the others follow
CASES = {
    "healthy": (),
    "backlash": (("backlash", "x"),),
    "coulomb_friction": (("coulomb_friction", "y"),),
    "gravity_load": (("gravity_load", "y"),),
    "command_delay": (("command_delay", "x"),),
    "sensor_lag": (("sensor_lag", "board_x"),),
    "pair": (("return_spring", "x"), ("dead_band", "y")),
    "supply_sag": (("supply_sag", "x"),),
    "torque_saturation": (("torque_saturation", "y"),),
    "outside": (("cogging", "x"),),
}


@dataclass(frozen=True)
class Timed:
    """A diagnosis: its seconds, its roll-outs, and the effects that it names."""

    seconds: float
    rollouts: int
    named: tuple[str, ...]


def measure() -> dict[str, float]:
    """`diagnosis_vs_1000_rollouts`, the median, `worst_vs_1000_rollouts`, and each case's own; the medians of roll-outs
    and of their cost.
    """
    sequence = find_sequence("excite_12s").commands[0]
    ratios, runs = {}, []
    with tempfile.TemporaryDirectory() as folder:
        program = build_loop(Path(folder))
        for number, (name, hidden) in enumerate(CASES.items()):
            model = draw(SEED + number)[2]
            recorded = play(rig(tuple(hide(*one) for one in hidden)), sequence, SEED + number)
            # Before and after, so that other work on the machine meets both alike.
            bare = [seconds_of_loop(program, model, recorded, Path(folder))]
            runs.append(timed_diagnosis(model, recorded))
            bare.append(seconds_of_loop(program, model, recorded, Path(folder)))
            ratios[name] = runs[-1].seconds / float(np.mean(bare))
            print(f"  {name}: {ratios[name]:.3g}, {runs[-1].rollouts} roll-outs", file=sys.stderr, flush=True)
    every = list(ratios.values())
    rollouts = np.array([run.rollouts for run in runs])
    return {
        "diagnosis_vs_1000_rollouts": float(np.median(every)),
        "worst_vs_1000_rollouts": max(every),
        "diagnosis_seconds": float(np.median([run.seconds for run in runs])),
        "diagnosis_rollouts": float(np.median(rollouts)),
        "diagnosis_rollout_vs_bare": float(np.median(ROLLOUTS * np.array(every) / rollouts)),
        **{f"diagnosis_vs_1000_rollouts_{name}": ratio for name, ratio in ratios.items()},
    }


def timed_diagnosis(model: Model, recorded: Play, only: tuple[str, ...] | None = None) -> Timed:
    """A diagnosis by the whole library, or by some of it."""
    started = time.perf_counter()
    diagnosis = diagnose(model, [recorded], only=only, experiments=False)
    named = diagnosis.verdict.effects if diagnosis.verdict.verdict == "effect" else ()
    return Timed(time.perf_counter() - started, diagnosis.verdict.evaluations, named)


def seconds_of_loop(program: Path, model: Model, recorded: Play, folder: Path) -> float:
    """What the C loop takes for 1,000 roll-outs of a play at MuJoCo's own step."""
    grid = recorded.trials.time
    sample = float(grid[1] - grid[0])
    steps = (len(grid) - 1) * round(sample / even_timestep(sample, None, model, False))
    return ROLLOUTS * steps / run_loop(program, model, folder)


if __name__ == "__main__":
    for key, value in measure().items():
        print(f"{key:50s} {value:.6g}")
