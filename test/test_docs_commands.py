# SPDX-License-Identifier: Apache-2.0
"""Every command line that README, tutorial and how-to pages show is run, or checked where that would take long.

`doc_blocks.py` tells by which comments a page says what is done with a block.
"""

import io
import itertools
import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from doc_blocks import ROOT, Block, blocks, missing
from doc_commands import check

from eps_tunnel_analysis.cli.main import main

LONGEST, PATIENCE = 1500, 90  # s; only what hangs takes so long
NODES = "## With nodes"
pytestmark = pytest.mark.timeout(1800)  # a busy machine is slow, and a page is long
HOWTO = sorted(f"docs/howto/{file.name}" for file in (ROOT / "docs" / "howto").glob("*.md"))
COGGING = "docs/howto/cogging.md"
# Pages whose commands work on one another's files, in this order.
TOGETHER = ("docs/howto/bags_from_csv.md", "docs/howto/own_rig.md")


def run(command: str, folder: Path, environment: dict[str, str]) -> str:
    """Runs a command line and returns what it printed; fails unless it ends with exit code 0."""
    if command.startswith("eps-tunnel ") and not re.search(r"[$|;&<>`]", command):
        return run_here(shlex.split(command)[1:], folder, environment)
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def run_here(words: list[str], folder: Path, environment: dict[str, str]) -> str:
    """The same of eps-tunnel's words, in this process: to start Python takes longer than many commands do."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(folder)
        for name, value in environment.items():
            patch.setenv(name, value)
        globbed = [sorted(str(found) for found in Path().glob(word)) if "*" in word else [word] for word in words]
        try:
            code = main([word for some in globbed for word in some])
        except SystemExit as end:  # argparse
            code = end.code
    assert code == 0, f"eps-tunnel {shlex.join(words)}\n{out.getvalue()}\n{err.getvalue()}"
    return out.getvalue()


@contextmanager
def followed(folder: Path, environment: dict[str, str]) -> Iterator["Follower"]:
    follower = Follower(folder, environment)
    try:
        yield follower
    finally:
        follower.end()


class Follower:
    """Does what pages say, in one folder."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._folder, self._environment = folder, environment
        self._background: list[subprocess.Popen[bytes]] = []

    def follow(self, block: Block) -> None:
        """Runs or checks every command of a block, or writes its file."""
        if block.file:
            target = self._folder / block.file
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text("\n".join(block.lines) + "\n", encoding="utf-8")
        if block.language != "console" or block.how.startswith("skip, "):
            return
        if block.how.startswith("instead "):
            run(block.how.removeprefix("instead "), self._folder, self._environment)
        for command, shown in block.commands():
            if block.how == "options" or block.how.startswith("instead "):
                check(command)
            elif block.how == "nodes":
                check(command)
                self._start(command.rstrip("& "))
                # A busy machine may take longer than the node that wants the ports waits for them.
                if " testbed " in command:
                    self._await_ports()
            else:
                assert block.how in ("", "workspace"), f"{block.name}: unknown comment '{block.how}'"
                line = command.replace(" src/", f" {ROOT}/src/") if block.how == "workspace" else command
                printed = run(line, self._folder, self._environment)
                assert not missing(shown, printed), f"{block.name}: {command} prints otherwise now:\n{printed}"

    def _start(self, command: str) -> None:
        log = (self._folder / f"{len(self._background)}.log").open("wb")
        self._background.append(
            subprocess.Popen(
                ["bash", "-c", f"exec {command}"], cwd=self._folder, env=self._environment, stdin=subprocess.DEVNULL,
                stdout=log, stderr=log, start_new_session=True,
            )
        )  # fmt: skip

    def _await_ports(self) -> None:
        deadline = time.monotonic() + PATIENCE
        while not all((self._folder / "ports" / name).exists() for name in ("servos", "sensors")):
            assert self._background[-1].poll() is None, "the testbed ended early"
            assert time.monotonic() < deadline, "the testbed opened no ports"
            time.sleep(0.05)

    def end(self) -> None:
        """Ends what still runs in the background."""
        for process in self._background:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
        for process in self._background:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


# In the place of the one that pages play; what they show of its figures is masked.
EXCITE = """
description: Three seconds on both axes.
initial_deg: {motor_x: 0, motor_y: 0}
trials: 5
command:
  motor_x:
    - step: {to_deg: 3, lasts_s: 0.5}
    - ramp: {to_deg: -2, lasts_s: 0.9}
    - triangle: {amplitude_deg: 1.5, frequency_hz: 1.25, lasts_s: 0.8}
    - step: {to_deg: 0, lasts_s: 0.8}
  motor_y:
    - hold: {lasts_s: 0.4}
    - step: {to_deg: -2.5, lasts_s: 0.6}
    - ramp: {to_deg: 2, lasts_s: 1.0}
    - step: {to_deg: 0, lasts_s: 1.0}
"""


@pytest.fixture
def shorter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sequence excite_12s takes three seconds."""
    (tmp_path / "config" / "sequences").mkdir(parents=True)
    (tmp_path / "config" / "sequences" / "excite_12s.yaml").write_text(EXCITE, encoding="utf-8")
    monkeypatch.setenv("EPS_TUNNEL_CONFIG", str(tmp_path / "config"))


def environment_of(folder: Path, **changes: str) -> dict[str, str]:
    return {**os.environ, "LABYRINTH_TESTBED_DIR": str(folder / "ports"), "PYTHONUNBUFFERED": "1", **changes}


@pytest.mark.parametrize(
    ("page", "end"),
    [("README.md", ""), pytest.param("docs/tutorial.md", NODES, marks=pytest.mark.study)],
    ids=["readme", "tutorial without nodes"],
)
@pytest.mark.usefixtures("shorter")
def test_every_command_of_a_page_works(page: str, end: str, tmp_path: Path) -> None:
    with followed(tmp_path, environment_of(tmp_path)) as follower:
        every = blocks(page, end=end)
        assert sum(len(block.commands()) for block in every if block.language == "console") > 5
        for block in every:
            follower.follow(block)


def test_each_block_of_the_tutorial_is_in_one_of_its_two_parts() -> None:
    assert blocks("docs/tutorial.md", end=NODES) + blocks("docs/tutorial.md", begin=NODES) == blocks("docs/tutorial.md")


def test_every_bag_that_the_tutorial_reads_was_made_by_a_command_before() -> None:
    made: set[str] = set()
    read: list[str] = []
    for block in blocks("docs/tutorial.md"):
        for command, _ in block.commands():
            words = shlex.split(command)
            for option in ("--real", "--sim"):
                named = words[words.index(option) + 1 :] if option in words else []
                paths = list(itertools.takewhile(lambda word: not word.startswith("-"), named))
                assert set(paths) <= made, f"{block.name}: {command}: nothing before makes {set(paths) - made}"
                read += paths
            if "--bag" in words:
                made.add(words[words.index("--bag") + 1])
            given = dict(word.split(":=", 1) for word in words if ":=" in word)
            if given.get("record") == "true":
                made |= {f"{given['folder']}/{given['sequence']}_{side}" for side in ("real", "sim")}
    assert len(set(read)) > 5


@pytest.mark.study
@pytest.mark.realtime
def test_every_command_of_the_tutorial_with_nodes_works(tmp_path: Path, domain: int) -> None:
    # The model that the page made before.
    model = (ROOT / "config" / "models" / "labyrinth_manual.yaml").read_text(encoding="utf-8")
    (tmp_path / "better.yaml").write_text(model.replace("name: labyrinth_manual", "name: better"), encoding="utf-8")
    environment = environment_of(tmp_path, ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    with followed(tmp_path, environment) as follower:
        every = blocks("docs/tutorial.md", begin=NODES)
        assert any(block.how == "nodes" for block in every)
        for block in every:
            follower.follow(block)


@pytest.mark.study
def test_bags_from_tables_go_through_a_rig_of_ones_own(tmp_path: Path) -> None:
    with followed(tmp_path, environment_of(tmp_path)) as follower:
        for page in TOGETHER:
            for block in blocks(page):
                follower.follow(block)
                if block.file == "pretend_rig.py":
                    shorten(tmp_path / block.file, "np.arange(800)", "np.arange(300)")


def shorten(file: Path, long: str, short: str) -> None:
    """Three seconds of the page's recordings show its friction, too."""
    text = file.read_text(encoding="utf-8")
    assert text.count(long) == 1, f"{file.name} has no '{long}' any more"
    file.write_text(text.replace(long, short), encoding="utf-8")


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.study] * (page == COGGING)) for page in HOWTO if page not in TOGETHER],
)
def test_every_command_of_a_how_to_page_works(page: str, tmp_path: Path) -> None:
    with followed(tmp_path, environment_of(tmp_path)) as follower:
        for block in blocks(page):
            follower.follow(block)
    if page == COGGING:
        the_law_holds_on_another_command(tmp_path)


def the_law_holds_on_another_command(folder: Path) -> None:
    """What the page's last comparison leaves, against the same model without the law."""
    line = "eps-tunnel compare --real study/other --model labyrinth --json"
    told = (run(line, folder, environment_of(folder)), (folder / "gap-after" / "compare.json").read_text("utf-8"))
    without, after = (
        next(e for e in json.loads(text)["errors"] if e["signal"] == "board_x")["command_error"] for text in told
    )
    assert math.degrees(without) > 0.2
    assert after < 0.1 * without and math.degrees(after) < 0.02


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md", *HOWTO])
def test_no_command_is_left_out_without_a_reason(page: str) -> None:
    for block in blocks(page):
        assert block.language != "", f"{block.name}: name the language; console for commands"
        assert block.language in ("console", "python", "yaml", "xml"), block.name
        assert not block.how.startswith("skip") or len(block.how) > len("skip, "), block.name
        assert block.language != "console" or block.commands(), f"{block.name}: a command begins with '$ '"
