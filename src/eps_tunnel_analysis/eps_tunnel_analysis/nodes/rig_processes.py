# SPDX-License-Identifier: Apache-2.0
"""The emulated rig, its simulation, the analysis and the player as child processes on a ROS domain of their own."""

import json
import os
import socket
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from eps_tunnel_analysis.processes import ProcessDied, Processes
from labyrinth_sim.errors import InputError

START_TIMEOUT = 90.0  # s; a busy machine takes its time
DRAW = "?"
DOMAINS = 100  # 1 to this; beyond 101 the ports of a domain reach into those that Linux hands out by chance


def _lock_port(domain: int) -> int:
    """The TCP port by which ROS's own domain_coordinator, that of tests, marks a domain as taken."""
    return 32768 + domain


@contextmanager
def own_domain(first: int | None = None) -> Iterator[int]:
    """A domain from 1 to 100, kept until the end; `first` is where the search begins, by default the process id.

    The lock is a port, not a file: it is shared as widely as the network in which nodes hear each other.
    """
    start = (os.getpid() if first is None else first) - 1
    for i in range(DOMAINS):
        domain = 1 + (start + i) % DOMAINS
        lock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        with closing(lock):
            try:
                lock.bind(("", _lock_port(domain)))
            except OSError:
                continue
            yield domain
            return
    raise InputError(f"All {DOMAINS} ROS domains are in use on this machine. End some demos or tests.")


def executable(package: str, name: str) -> Path:
    """The file that `ros2 run PACKAGE NAME` starts. Raises InputError where the workspace is not sourced."""
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / name
    except PackageNotFoundError:
        raise InputError(f"Package {package} is not found. Source the workspace: `source env.bash`.") from None
    if not path.is_file():
        raise InputError(f"{path} is missing. Build the workspace: `make setup`.")
    return path


@dataclass(frozen=True)
class EmulatedRig:
    """What is emulated.

    Attributes:
        testbed, hw: names or paths of config/testbed and config/hw files.
        hidden: effects hidden in it in addition to those of the file, `NAME[.AXIS][=STRENGTH]`; "?" draws one.
        seed: of its noise, and of the draw.
        video: whether its camera shows board and ball, which takes most of a processor core.
    """

    testbed: str = "healthy"
    hw: str = "healthy"
    hidden: tuple[str, ...] = ()
    seed: int = 1
    video: bool = False


@contextmanager
def rig_processes(rig: EmulatedRig, model: str, folder: Path) -> Iterator[Processes]:
    """Runs testbed, hw_node, sim_node, analysis_node and player until the end of the block.

    This process joins their domain: its own nodes see them and no other rig receives from it.

    Args:
        model: of the simulation, a name or a path.
        folder: receives logs/ and hidden.json, what the testbed hides.

    Raises:
        InputError: the testbed refuses its input.
        ProcessDied: it ended for another reason.
    """
    logs = folder / "logs"
    logs.mkdir()
    with own_domain() as domain, tempfile.TemporaryDirectory(prefix="eps_tunnel_ports_") as ports:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        environment = {**os.environ, "XDG_RUNTIME_DIR": ports, "PYTHONUNBUFFERED": "1"}
        with Processes(logs, environment) as processes:
            given = ["--config", rig.testbed, "--seed", str(rig.seed), "--reveal", str(folder / "hidden.json")]
            given += [part for name in rig.hidden for part in (["--draw"] if name == DRAW else ["--effect", name])]
            given += ["--video"] if rig.video else []
            processes.start("testbed", [executable("labyrinth_hw", "testbed"), *given])
            _wait_for_ports(Path(ports), processes)
            # Nothing can be harmed here. While the other processes start, a testbed may answer too late for its servos.
            armed = _parameters(config=rig.hw, arm="true", disarm_after=0.0, connect_timeout=START_TIMEOUT)
            processes.start("hw_node", [executable("labyrinth_hw", "hw_node"), *armed])
            processes.start("sim_node", [executable("labyrinth_sim", "sim_node"), *_parameters(model=model)])
            processes.start("analysis_node", [executable("eps_tunnel_analysis", "analysis_node")])
            # A busy machine may leave a node waiting for a while; a rig that is gone stays silent for longer.
            patience = _parameters(connect_timeout=START_TIMEOUT, silence_timeout=3.0, stall_timeout=0.3)
            processes.start("player", [executable("eps_tunnel_analysis", "player"), *patience])
            yield processes


def hidden_in(folder: Path) -> list[dict[str, Any]]:
    """What the testbed hid beyond its ordinary faults: effect, axis, strength, values of each."""
    path = folder / "hidden.json"
    hidden: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["hidden"] if path.exists() else []
    return hidden


def hidden_in_words(hidden: Sequence[Mapping[str, Any]]) -> str:
    """What was hidden, in words."""
    words = [f"{item['effect']} on {item['axis']} ({item['strength']})" for item in hidden]
    return ", ".join(words) or "nothing"


def _wait_for_ports(folder: Path, processes: Processes) -> None:
    deadline = time.monotonic() + START_TIMEOUT
    while len(list(folder.rglob("*"))) < 3:  # the folder of links, servos, sensors
        try:
            processes.check()
        except ProcessDied as died:
            if died.code == 2:
                raise InputError(processes.tail("testbed").strip()) from died
            raise
        if time.monotonic() > deadline:
            raise ProcessDied(f"the testbed opened no ports. Its last lines:\n{processes.tail('testbed')}")
        time.sleep(0.05)


def _parameters(**values: object) -> list[str]:
    return ["--ros-args", *(part for name, value in values.items() for part in ("-p", f"{name}:={value}"))]
