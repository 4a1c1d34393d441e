# SPDX-License-Identifier: Apache-2.0
"""A fit that was killed goes on from its checkpoint to the same result, bit for bit, by every method."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from checkpoint_cases import METHODS, fit, fit_until

from eps_tunnel_analysis.calibration.calibrate import Fit

WAIT = 120  # s


@pytest.fixture(scope="module")
def children() -> Iterator[multiprocessing.context.ForkServerContext]:
    """Starts real processes that need not import everything anew."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["checkpoint_cases"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
        patch.setattr(sys.modules["__main__"], "__spec__", None)  # pytest itself, which no child is to run
        patch.delattr(sys.modules["__main__"], "__file__", raising=False)
        yield context


@pytest.fixture(scope="module", params=METHODS)
def whole(request: pytest.FixtureRequest) -> tuple[str, Fit]:
    """A method, and its fit when nothing comes between."""
    return request.param, fit(request.param)


@pytest.mark.parametrize("death", [
    pytest.param("SIGINT", marks=pytest.mark.study), "SIGTERM", "SIGKILL", "half a line", "a torn line",
])  # fmt: skip
def test_a_killed_fit_goes_on_to_the_same_result(whole, children, tmp_path: Path, death: str) -> None:
    method, expected = whole
    journal = tmp_path / "checkpoint"
    here, there = children.Pipe()
    child = children.Process(target=fit_until, args=(method, journal, expected.evaluations // 2, there))
    child.start()
    there.close()
    assert here.poll(WAIT)
    done = here.recv()
    number = getattr(signal, death, signal.SIGKILL)
    os.kill(child.pid, number)
    child.join(WAIT)
    if death == "SIGINT":
        assert child.exitcode == 0
        assert here.recv()[0], "Ctrl-C ends a fit with the best so far"
    else:
        assert child.exitcode == -number
    raw = journal.read_bytes()
    if death == "half a line":
        journal.write_bytes(raw[:-13])
    elif death == "a torn line":
        journal.write_bytes(raw[:-13] + bytes(13))
    assert expected.evaluations > done > 1, "the fit was killed in its middle"
    again = fit(method, journal)
    assert repr(replace(again, seconds=0.0)) == repr(replace(expected, seconds=0.0))
    assert journal.read_bytes().startswith(raw)
