# SPDX-License-Identifier: Apache-2.0
"""On a full disk every command ends with exit code 2 and a sentence, and leaves nothing of what it was to write."""

import errno
import os
import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from bag_files import command, grid, response
from command_line import COMMAND, ENVIRONMENT, eps_tunnel
from fit_cases import bag_of, plays

from labyrinth_sim.config import find
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model, save_model
from labyrinth_sim.whole_file import write_new


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file of this process can become larger than `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, bags: Path) -> Path:
    """A table, and two plays of the labyrinth; the folder `bags` holds those of a servo."""
    folder = tmp_path_factory.mktemp("inputs")
    rows = zip(grid(), command(grid()), response(grid()), strict=True)
    (folder / "log.csv").write_text("t,goal,angle\n" + "".join(f"{t},{u},{y}\n" for t, u, y in rows))
    for number, play in enumerate(plays((-2.0, 3.0), trials=1)):
        bag_of(folder / "plays" / f"bag{number}", play.trials)
    (folder / "horn.xml").symlink_to(find("mjcf", "horn"))
    (folder / "bags").symlink_to(bags)
    return folder


COMMANDS = {
    "compare": "compare --real {0}/bags/real --sim {0}/bags/sim --out",
    "import-csv": "import-csv {0}/log.csv --time t --command servo=goal --position servo=angle --out",
    "repair": "repair {0}/bags/sim --out",
    "sequences": "sequences excite_12s --csv",
    "calibrate": "calibrate --real {0}/plays --model labyrinth --signals motor_x --free drive.x.p --method es "
    "--generations 1 --progress none --out",
    "sweep": "sweep drive.x.p=10:20:2 --real {0}/plays/bag0 --model labyrinth --signals motor_x --out",
    "new-rig": "new-rig {0}/horn.xml --csv {0}/log.csv --no-check --out",
    "diagnose": "diagnose --real {0}/plays --model labyrinth --signals motor_x --candidates gain_error "
    "--progress lines --out",
}


@pytest.mark.parametrize("size", [0, pytest.param(700, marks=pytest.mark.study)])
@pytest.mark.parametrize("line", COMMANDS.values(), ids=COMMANDS)
def test_a_command_on_a_full_disk_leaves_nothing(inputs: Path, tmp_path: Path, line: str, size: int) -> None:
    out = tmp_path / "new" / "out"
    with full_disk(size):
        result = eps_tunnel(*line.format(inputs).split(), out)
    assert result.returncode == 2, result.stdout
    assert os.strerror(errno.EFBIG) in result.stderr
    assert str(out.parent) in result.stderr and "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_mjcf_is_not_left_without_its_module(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    module = tmp_path / "file" / "module.py"
    result = eps_tunnel("export", "--model", "labyrinth", "--mjcf", tmp_path / "new" / "out.xml", "--module", module)
    assert result.returncode == 2
    assert str(tmp_path / "file") in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_model_on_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    with full_disk(100), pytest.raises(InputError, match="cannot be written"):
        save_model(load_model("labyrinth"), tmp_path / "a" / "b" / "model.yaml")
    assert list(tmp_path.iterdir()) == []


def test_what_was_there_before_stays(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with full_disk(0), pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
        write_new(tmp_path / "there" / "deeper" / "file", "text")
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_terminal_that_takes_nothing_is_said_once() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [*COMMAND, "effects", "--json"], stdout=full, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
        )
    assert (done.returncode, done.stderr) == (2, f"eps-tunnel effects: {os.strerror(errno.ENOSPC)}\n")
