# SPDX-License-Identifier: Apache-2.0
"""Work on a Dask cluster, one of whose workers is killed in the middle: the answer is the same to the last bit."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fit_cases import FREE, TRUTH, plays, start

from eps_tunnel_analysis.calibration.calibrate import Settings, calibrate
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.fit.cluster import cluster, connected, each
from eps_tunnel_analysis.fit.methods import EvolutionStrategy
from eps_tunnel_analysis.fit.problem import Objective
from labyrinth_sim.errors import InputError

pytest.importorskip("distributed")
SIGNALS = ("motor_x",)
PATIENCE = 90  # s; only what hangs takes so long


class DaskCluster:
    """A scheduler and worker processes."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._file = folder, folder / "scheduler.json"
        self._processes: list[subprocess.Popen[bytes]] = []
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address", ":0")

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--scheduler-file", str(self._file), *options]
        self._processes.append(subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL))
        return self._processes[-1]

    def with_two_workers(self) -> tuple[str, subprocess.Popen[bytes]]:
        """The address, and one of the two; as many are started as it takes."""
        from distributed import Client

        deadline = time.monotonic() + PATIENCE
        while not self._file.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        running = [process for process in self._processes[1:] if process.poll() is None]
        for _ in range(2 - len(running)):
            name = f"worker_{len(self._processes)}"
            options = ("--no-nanny", "--nthreads", "1", "--no-dashboard", "--name", name)
            running.append(self._start("dask_worker", *options, "--local-directory", str(self._folder / name)))
        with Client(scheduler_file=str(self._file), timeout=PATIENCE, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=PATIENCE)
            return client.scheduler.address, running[0]

    def close(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    made = DaskCluster(tmp_path_factory.mktemp("dask"))
    yield made
    made.close()


def kill_soon(worker: subprocess.Popen[bytes]) -> None:
    """While the next batch is on its way, not between two."""
    if worker.poll() is None:
        threading.Timer(0.02, worker.send_signal, [signal.SIGKILL]).start()


@pytest.mark.study
@pytest.mark.realtime
def test_a_fit_is_the_same(dask: DaskCluster) -> None:
    recorded = plays((3.0, -2.0))
    settings = Settings(method=EvolutionStrategy(generations=6, offspring=40), seed=4, signals=SIGNALS)
    alone = calibrate(start(), FREE, recorded, settings)
    address, worker = dask.with_two_workers()

    def murder(count: int, _: float) -> None:
        if count > 100:
            kill_soon(worker)

    with cluster(address) as spread:
        shared = calibrate(start(), FREE, recorded, replace(settings, spread=spread), murder)
    assert worker.wait(timeout=PATIENCE) == -signal.SIGKILL
    assert shared.parameters == alone.parameters
    assert shared.history == alone.history


@pytest.mark.realtime
def test_a_diagnosis_is_the_same(dask: DaskCluster) -> None:
    recorded = plays((3.0,))
    model = start().with_values({**TRUTH, "drive.x.p": 16.0})
    alone = diagnose(model, recorded, only=(), nthread=1).verdict
    address, worker = dask.with_two_workers()

    def murder(_: str, count: int, of: int = 0) -> None:
        if count > 100:
            kill_soon(worker)

    with cluster(address) as spread:
        shared = diagnose(model, recorded, only=(), progress=murder, spread=spread).verdict
    assert worker.wait(timeout=PATIENCE) == -signal.SIGKILL
    assert {**shared.to_json(), "seconds": 0} == {**alone.to_json(), "seconds": 0}


@pytest.mark.realtime
def test_tasks_of_their_own_are_all_done(dask: DaskCluster) -> None:
    objective = Objective(start(), FREE, plays((3.0,)), SIGNALS)
    rows = [row[None] for row in np.tile(list(TRUTH.values()), (12, 1)) * np.linspace(0.8, 1.2, 12)[:, None]]
    address, worker = dask.with_two_workers()
    done = []
    with connected(address) as client:
        for result in each(client, objective, rows):
            done.append(result.tobytes())
            kill_soon(worker)
    assert worker.wait(timeout=PATIENCE) == -signal.SIGKILL
    assert sorted(done) == sorted(objective(row).tobytes() for row in rows)


def test_a_scheduler_that_is_not_there_is_told() -> None:
    with pytest.raises(InputError, match="no scheduler"), cluster("tcp://127.0.0.1:9", timeout=0.5):
        pass
