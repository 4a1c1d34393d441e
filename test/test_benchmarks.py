# SPDX-License-Identifier: Apache-2.0
"""Every benchmark starts: what it imports is where it looks for it."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
# All in one process, for to import MuJoCo takes longer than all else; each finds its own folder first on the path.
PROGRAM = """
import runpy, sys, traceback
from pathlib import Path
for file in map(Path, sys.argv[1:]):
    path, sys.argv = list(sys.path), [str(file), "--help"]
    sys.path[0] = str(file.parent)
    try:
        runpy.run_path(str(file), run_name="__main__" if file.parent.name == "benchmarks" else "section")
        ended = 0
    except SystemExit as end:
        ended = end.code
    except BaseException:
        ended = traceback.format_exc()
    sys.path = path
    print(f"ENDED {file.name}: {ended}", flush=True)
"""


@pytest.fixture(scope="module")
def ended() -> dict[str, str]:
    """File name -> how it ended: "0", or what went wrong."""
    files = [*sorted(BENCHMARKS.glob("*.py")), *sorted((BENCHMARKS / "sections").glob("*.py"))]
    done = subprocess.run([sys.executable, "-c", PROGRAM, *files], capture_output=True, text=True, check=True)
    parts = [part.partition(": ") for part in done.stdout.split("ENDED ")[1:]]
    # What the next one prints follows after the line.
    return {name: "0" if told.startswith("0\n") else told for name, _, told in parts}


@pytest.mark.parametrize("file", sorted(p.name for p in BENCHMARKS.glob("*.py")))
def test_a_benchmark_starts(ended: dict[str, str], file: str) -> None:
    assert ended[file] == "0"


@pytest.mark.parametrize("file", sorted(p.name for p in (BENCHMARKS / "sections").glob("*.py")))
def test_a_section_of_the_speed_benchmark_loads(ended: dict[str, str], file: str) -> None:
    assert ended[file] == "0"
