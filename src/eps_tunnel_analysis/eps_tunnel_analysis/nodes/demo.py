# SPDX-License-Identifier: Apache-2.0
"""The main job from end to end: an emulated rig and its simulation play a sequence, and the gap is measured."""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from eps_tunnel_analysis.nodes.processes import ProcessDied, Processes, executable
from eps_tunnel_analysis.nodes.progress import Progress, ProgressBar
from eps_tunnel_analysis.recording.reader import read
from eps_tunnel_analysis.recording.trials_from_bags import to_trials
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_msgs.action import PlaySequence
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model

START_TIMEOUT = 40.0  # s
SIGNALS = ("motor_x", "motor_y", "board_x", "board_y")


def parser() -> argparse.ArgumentParser:
    """Options of `ros2 run eps_tunnel_analysis demo`."""
    p = argparse.ArgumentParser(
        prog="demo",
        description="Plays a sequence on the emulated testbed and on its simulation at once, records one bag per "
        "side, and reports how far apart they are and where. Needs no rig, no screen, no root.",
    )
    p.add_argument("--sequence", default="paper_8s", help="name or path of the sequence (default: %(default)s)")
    p.add_argument(
        "--trials", type=_count, default=4, metavar="N", help="how often it is played (default: %(default)s)"
    )
    p.add_argument("--model", default="labyrinth", help="name or path of the simulation's model (default: %(default)s)")
    p.add_argument("--testbed", default="paper", metavar="CONFIG", help="config/testbed/*.yaml (default: %(default)s)")
    p.add_argument("--hw", default="paper", metavar="CONFIG", help="config/hw/*.yaml (default: %(default)s)")
    p.add_argument("--effect", action="append", default=[], metavar="NAME", help="hide one more effect in the testbed; "
                   "? draws one, told at the end")  # fmt: skip
    p.add_argument("--seed", type=int, default=1, help="of the testbed's noise and draw (default: %(default)s)")
    p.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="where demo-N is made (default: out)")
    return p


def main(args: Sequence[str] | None = None) -> int:
    """Returns 0, 2 for bad input, 1 when a process died or the run failed, 130 after Ctrl-C."""
    given = parser().parse_args(_without_ros(sys.argv[1:] if args is None else args))
    began = time.monotonic()
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        find_sequence(given.sequence)
        model = load_model(given.model)
        folder = _fresh_folder(given.out)
        print(f"Demo into {folder}: bags, logs and report.", flush=True)
        bags = _measure(given, folder)
        print(
            f"\nReal is the emulated rig '{given.testbed}'; the simulation is '{model.name}': {model.description}\n"
            f"Alikeness is the share of time in which the simulation stays inside what {given.trials} real trials "
            "spanned: 100 % is no gap.\n",
            flush=True,
        )
        _compare(bags, folder)
        _tell_hidden(folder / "hidden.json")
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except (ProcessDied, DemoFailed) as error:
        print(f"\nThe demo ended early: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nInterrupted; what was recorded until then is whole.", file=sys.stderr)
        return 130
    real = " ".join(str(bag) for bag in bags if bag.name.endswith("_real"))
    print(f"Next, to narrow the gap: eps-tunnel calibrate --real {real} --model {given.model} --out fitted.yaml")
    print(f"Done in {time.monotonic() - began:.0f} s. Page with pictures: {(folder / 'gap' / 'report.html').resolve()}")
    return 0


class DemoFailed(Exception):
    """The sequence was not played to its end, or could not be compared."""


def _measure(given: argparse.Namespace, folder: Path) -> list[Path]:
    """Runs all nodes and plays the sequence; returns the bags, real first."""
    domain = 1 + os.getpid() % 100
    # Own domain, this machine only: a rig on the same network must not hear these commands.
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    logs = folder / "logs"
    logs.mkdir()
    effects = [part for name in given.effect for part in (["--draw"] if name == "?" else ["--effect", name])]
    with tempfile.TemporaryDirectory(prefix="demo_ports_") as ports:
        environment = {**os.environ, "XDG_RUNTIME_DIR": ports, "PYTHONUNBUFFERED": "1"}
        with Processes(logs, environment) as processes:
            testbed = executable("labyrinth_hw", "testbed")
            reveal = ["--reveal", str(folder / "hidden.json"), "--seed", str(given.seed)]
            processes.start("testbed", [testbed, "--config", given.testbed, *reveal, *effects])
            _wait_for_ports(Path(ports), processes)
            processes.start("hw_node", [executable("labyrinth_hw", "hw_node"), *_parameters(config=given.hw)])
            processes.start("sim_node", [executable("labyrinth_sim", "sim_node"), *_parameters(model=given.model)])
            processes.start("analysis_node", [executable("eps_tunnel_analysis", "analysis_node")])
            # A busy machine may leave a node waiting for a while; a rig that is gone stays silent for longer.
            patience = _parameters(connect_timeout=START_TIMEOUT, silence_timeout=3.0, stall_timeout=0.3)
            processes.start("player", [executable("eps_tunnel_analysis", "player"), *patience])
            print(
                f"Five processes run. To watch them: export ROS_DOMAIN_ID={domain}, then ros2 topic echo /srg",
                flush=True,
            )
            bags = _play(given, folder / "bags", processes)
    return [Path(bag) for bag in bags]


def _play(given: argparse.Namespace, folder: Path, processes: Processes) -> list[str]:
    """Sends the goal and shows its progress. Raises DemoFailed with the player's own words."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("demo")
    client = ActionClient(node, PlaySequence, "/play_sequence")
    try:
        deadline = time.monotonic() + START_TIMEOUT
        while not client.server_is_ready():
            processes.check()
            if time.monotonic() > deadline:
                raise DemoFailed(f"the player did not appear within {START_TIMEOUT:g} s. See {folder.parent / 'logs'}.")
            rclpy.spin_once(node, timeout_sec=0.1)
        goal = PlaySequence.Goal(
            sequence=given.sequence, trials=given.trials, record=True, folder=str(folder.resolve())
        )
        with ProgressBar() as bar:

            def show(message: Any) -> None:
                f = message.feedback
                bar.show(Progress(f.trial, f.trials, f.phase, f.progress, f.time_left))

            handle = _await(node, client.send_goal_async(goal, feedback_callback=show), processes)
            if not handle.accepted:
                raise DemoFailed("the player refused the goal.")
            result: PlaySequence.Result = _await(node, handle.get_result_async(), processes).result
        if not result.success:
            raise DemoFailed(f"{result.message}\nThe hardware node's last lines:\n{processes.tail('hw_node')}")
        print(result.message, flush=True)
        return list(result.bags)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _await(node: Node, future: Any, processes: Processes) -> Any:
    """The future's result, while the processes are watched."""
    while not future.done():
        rclpy.spin_until_future_complete(node, future, timeout_sec=0.5)
        processes.check()
    return future.result()


def _wait_for_ports(folder: Path, processes: Processes) -> None:
    deadline = time.monotonic() + START_TIMEOUT
    while len(list(folder.rglob("*"))) < 3:  # the folder of links, servos, sensors
        processes.check()
        if time.monotonic() > deadline:
            raise DemoFailed(f"the testbed opened no ports. Its last lines:\n{processes.tail('testbed')}")
        time.sleep(0.05)


def _compare(bags: Sequence[Path], folder: Path) -> None:
    """The offline comparison of the bags, as a user would call it."""
    real = [str(bag) for bag in bags if bag.name.endswith("_real")]
    sim = [str(bag) for bag in bags if bag.name.endswith("_sim")]
    out = ["--out", str(folder / "gap"), "--signals", *_measured_throughout(bags)]
    done = subprocess.run(
        [executable("eps_tunnel_analysis", "eps_tunnel"), "compare", "--real", *real, "--sim", *sim, *out], check=False
    )
    if done.returncode:
        raise DemoFailed(
            f"`eps_tunnel compare` ended with exit code {done.returncode}. The bags are in {folder / 'bags'}."
        )


def _measured_throughout(bags: Sequence[Path]) -> list[str]:
    """The signals measured throughout every trial; on a busy machine the sensor line may have missed one."""
    incomplete: dict[str, str] = {}
    for recording in map(read, bags):
        for name in SIGNALS:
            try:
                to_trials([recording], signals=[name])
            except InputError as error:
                incomplete[name] = f"{name} is left out. {error}"
    for complaint in incomplete.values():
        print(complaint)
    return [name for name in SIGNALS if name not in incomplete]


def _tell_hidden(path: Path) -> None:
    """What the testbed hid beyond its ordinary faults, now that the figures are told."""
    hidden = json.loads(path.read_text(encoding="utf-8")).get("hidden", []) if path.exists() else []
    if hidden:
        told = ", ".join(f"{h['effect']} on {h['axis']} ({h['strength']})" for h in hidden)
        print(f"Hidden in the testbed: {told}. With values: {path}")


def _parameters(**values: object) -> list[str]:
    return ["--ros-args", *(part for name, value in values.items() for part in ("-p", f"{name}:={value}"))]


def _without_ros(args: Sequence[str]) -> list[str]:
    given = list(args)
    return given[: given.index("--ros-args")] if "--ros-args" in given else given


def _fresh_folder(out: Path) -> Path:
    """A new folder demo-N, numbered from 1; two demos at once never get the same."""
    number = 1
    while True:
        folder = out / f"demo-{number}"
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            number += 1
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror}). Choose another folder by --out.") from error


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got '{text}'")
    return int(text)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
