# SPDX-License-Identifier: Apache-2.0
"""`eps-tunnel` as tests call it: in this process, which spares a start of Python each, or in one of its own."""

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

from eps_tunnel_analysis.cli.main import main

PATHS = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2] / "labyrinth_sim")]
WIDTH = {"COLUMNS": "120"}
ENVIRONMENT = {**os.environ, **WIDTH, "PYTHONPATH": os.pathsep.join([*PATHS, os.environ.get("PYTHONPATH", "")])}
COMMAND = [sys.executable, "-m", "eps_tunnel_analysis.cli"]


def eps_tunnel(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Calls the entry point in this process; what it prints and its exit code."""
    out, err = io.StringIO(), io.StringIO()
    line = [str(a) for a in arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), mock.patch.dict(os.environ, WIDTH):
        try:
            code = main(line)
        except SystemExit as ended:  # argparse
            code = int(ended.code or 0)
    return subprocess.CompletedProcess(line, code, out.getvalue(), err.getvalue())


def process(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """The same in a process of its own."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, env=ENVIRONMENT, timeout=120
    )


def refused(*arguments: object, told: "list[object]", call=eps_tunnel) -> str:
    """Runs a command that must end with exit code 2, without a traceback, and with all of `told` on stderr."""
    result = call(*arguments)
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert not result.stdout
    for text in told:
        assert str(text) in result.stderr
    return result.stderr
