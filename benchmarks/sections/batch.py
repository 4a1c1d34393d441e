# SPDX-License-Identifier: Apache-2.0
"""Steps per second of the batch against mj_step in a C loop on as many cores, and by size of batch."""

import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np

from labyrinth_sim.build import compiled
from labyrinth_sim.engine import Engine
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import numbers_of, simulate_batch

CORES = len(os.sched_getaffinity(0))
SIZES = (1, 10, 100, 1000, 10_000)
SMALL = {8: 40, 64: 10}
"""Size of a batch -> calls that are timed together."""
SAMPLES = 201
REPEATS = 5


def measure() -> dict[str, float]:
    """`batch_vs_limit`, also of small batches, `batch_vs_limit_per_step`, and steps per second by size of batch."""
    plain = load_model("labyrinth_manual")
    native = plain.with_effect("belt_compliance", "x").with_effect("coulomb_friction", "y")
    per_step = plain.with_effect("stribeck_friction", "x").with_effect("load_friction", "y")
    figures: dict[str, float] = {"batch_cores": float(CORES)}
    with tempfile.TemporaryDirectory() as folder:
        program = build_loop(Path(folder))
        for key, model in (("batch_vs_limit", native), ("batch_vs_limit_per_step", per_step)):
            ratios, rates, limits = [], [], []
            for _ in range(REPEATS):  # in turns, so that other work on the machine meets both alike
                limits.append(run_loop(program, model, Path(folder)))
                rates.append(rate(model, 1000))
                ratios.append(rates[-1] / limits[-1])
            figures |= {key: float(np.median(ratios)), f"{key}_steps_per_s": max(rates), f"{key}_limit": max(limits)}
        for size, calls in SMALL.items():
            pairs = [(rate(native, size, calls), run_loop(program, native, Path(folder))) for _ in range(REPEATS)]
            figures[f"batch_vs_limit_{size}"] = float(np.median([own / limit for own, limit in pairs]))
    for size in SIZES:
        figures[f"batch_steps_per_s_{size}"] = rate(native, size)
        # The peak only ever grows, so each size shows its own need as long as the sizes do.
        figures[f"batch_peak_MiB_{size}"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return figures


def rate(model: Model, size: int, calls: int = 1) -> float:
    """Steps per second of some calls: parameters set, commands filtered, everything recorded."""
    time_grid = np.arange(SAMPLES) * 0.01
    commands = 0.05 * np.sin(5 * time_grid)[None, :, None] * np.array([1.0, -1.0])
    values = np.linspace(5.0, 20.0, size)[:, None]
    begin = time.perf_counter()
    steps = sum(
        simulate_batch(model, ["drive.x.p"], values, time_grid, commands, nthread=CORES).steps for _ in range(calls)
    )
    return steps / (time.perf_counter() - begin)


def build_loop(folder: Path) -> Path:
    """Compiles the C loop against the library of the installed MuJoCo."""
    home = Path(mujoco.__file__).parent
    library = next(home.glob("libmujoco.so*"))
    program = folder / "mj_step_loop"
    source = Path(__file__).with_name("mj_step_loop.c")
    flags = ["-O3", "-march=native", f"-I{home / 'include'}", str(library), f"-Wl,-rpath,{home}", "-lpthread", "-lm"]
    subprocess.run(["gcc", str(source), "-o", str(program), *flags], check=True)
    return program


def run_loop(program: Path, model: Model, folder: Path) -> float:
    """Steps per second of the C loop on the same compiled model with the same values."""
    plan = compiled(model, with_ball=False)
    engine = Engine(model, plan, numbers_of(model, 1), 1, 0.01, nthread=1)
    file = folder / "model.mjb"
    mujoco.mj_saveModel(engine.batch.get_model(0), str(file), None)
    command = [str(program), str(file), str(CORES), "40000", str(engine.substeps)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
