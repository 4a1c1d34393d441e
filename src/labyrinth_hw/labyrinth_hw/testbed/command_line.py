# SPDX-License-Identifier: Apache-2.0
"""`ros2 run labyrinth_hw testbed`: an emulated rig behind pseudo-serial ports. Needs no ROS."""

import argparse
import json
import os
import select
import signal
import sys
import time
from pathlib import Path
from types import FrameType

from labyrinth_hw.config import write_new
from labyrinth_hw.devices import ask_for_priority, default_link_dir
from labyrinth_hw.errors import HardwareError, InputError
from labyrinth_hw.testbed.hidden import TestbedConfig, listing, load_testbed
from labyrinth_hw.testbed.live import FAULTS, LiveRig, LiveTestbed
from labyrinth_hw.testbed.scene import load_layout
from labyrinth_hw.testbed.video import VideoProcess

MOST_TRIALS = 10_000
MOST_SAMPLES = 2_000_000  # of a bag, in all its trials


def parser() -> argparse.ArgumentParser:
    """Options of `testbed`."""
    p = argparse.ArgumentParser(
        prog="testbed",
        description="An emulated labyrinth behind pseudo-serial ports: two Dynamixel servos and a sensor line, with "
        "separate physics and the faults that a YAML file describes. Needs no ROS.",
        epilog=f"Faults, one a line on standard input. {FAULTS}",
    )
    p.add_argument(
        "--config", default="paper", help="name or path of a config/testbed/*.yaml (default: paper); see --list"
    )
    p.add_argument("--list", action="store_true", help="list the known rigs and effects, and end")
    p.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[.AXIS][=STRENGTH]",
        help="hide one more effect, e.g. backlash.x=strong",
    )
    p.add_argument("--seed", type=int, help="of the noise; without --effect and with --draw, of the hidden effect too")
    p.add_argument("--draw", action="store_true", help="hide an effect picked at random by the seed")
    p.add_argument("--reveal", type=Path, metavar="FILE", help="write what is hidden to this JSON file")
    p.add_argument("--link-dir", type=Path, help=f"folder of the links to the ports (default: {default_link_dir()})")
    p.add_argument("--baud", type=int, help="emulated speed of the servo bus (default: the config's)")
    p.add_argument("--video", type=int, nargs="?", const=0, metavar="PORT", help="stream the camera; 0: any free port")
    p.add_argument("--video-rate", type=float, default=30.0, help="pictures per second (default: 30)")
    p.add_argument("--bag", type=Path, metavar="FOLDER", help="no ports: play --commands at once and write this bag")
    p.add_argument("--commands", type=Path, metavar="CSV", help="columns time, motor_x, motor_y (s, rad); for --bag")
    p.add_argument("--trials", type=int, default=5, help="of the commands, for --bag (default: 5)")
    p.add_argument("--with-ball", action="store_true", help="put a ball on the board, for --bag")
    p.add_argument("--duration", type=float, help="stop after this many seconds")
    return p


def main(arguments: list[str] | None = None) -> None:
    """Run the testbed until Ctrl-C, SIGTERM or --duration."""
    given, _ = parser().parse_known_args(_without_ros(sys.argv[1:] if arguments is None else arguments))
    try:
        if given.list:
            print(listing())
            return
        seed = given.seed if given.seed is not None else int.from_bytes(os.urandom(4), "little")
        loaded = load_testbed(given.config, effects=given.effect, draw_seed=seed if given.draw else None)
        if given.reveal is not None:
            write_new(given.reveal, json.dumps(loaded.revealed(), indent=2) + "\n")
        if given.bag is not None:
            try:
                offline(loaded, given.bag, given.commands, given.trials, seed, given.with_ball)
            except BaseException:
                if given.reveal is not None:
                    given.reveal.unlink()  # of a rig that was not recorded
                raise
            return
        run(loaded, given, given.link_dir or default_link_dir(), seed)
    except (InputError, HardwareError) as error:
        print(f"testbed: {error}", file=sys.stderr)
        raise SystemExit(2) from error


def offline(loaded: TestbedConfig, bag: Path, commands: Path | None, trials: int, seed: int, with_ball: bool) -> None:
    """Play commands on the rig without ports or real time and write a bag."""
    from labyrinth_hw.testbed.bags import read_commands, write_bag
    from labyrinth_hw.testbed.offline import run_offline

    if commands is None:
        raise InputError("--bag needs --commands CSV: columns time, motor_x, motor_y (s, rad).")
    if bag.exists():
        raise InputError(f"{bag} exists and is left as it is; name another folder.")
    time_, goals, digest = read_commands(commands)
    if not 1 <= trials <= MOST_TRIALS or trials * len(time_) > MOST_SAMPLES:
        raise InputError(
            f"--trials {trials} of {len(time_)} samples: expected 1 to {MOST_TRIALS} trials, and at most "
            f"{MOST_SAMPLES} samples in all. Write several bags."
        )
    if not 0 <= seed < 2**63:
        raise InputError(f"--seed {seed}: expected a whole number from 0 to 2^63 - 1.")
    layout = load_layout(loaded.layout) if with_ball else None
    result = run_offline(loaded, time_, goals, trials, seed, layout)
    print(f"bag: {write_bag(bag, result, commands.stem, digest)}", flush=True)


def run(loaded: TestbedConfig, given: argparse.Namespace, link_dir: Path, seed: int) -> None:
    """Serve the ports until a signal or the end of --duration."""
    stop: list[int] = []

    def interrupted(number: int, frame: FrameType | None) -> None:
        stop.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupted)
    baud = given.baud or loaded.baud
    layout = load_layout(loaded.layout) if given.video is not None else None
    rig = LiveRig(loaded.reality, loaded.servo, seed, time.monotonic(), layout, loaded.mode)
    video = None
    if given.video is not None:
        video = VideoProcess(loaded.layout, given.video, given.video_rate, seed, loaded.marble)
    testbed = LiveTestbed(rig, link_dir, baud, loaded.sensor_baud, seed, video)
    end = time.monotonic() + given.duration if given.duration is not None else float("inf")
    lines = InputLines()

    def orders(now: float) -> None:
        for line in lines.new():
            print(testbed.fault(line.split()), flush=True)

    for name, line in testbed.lines.items():
        print(f"{name}: {line.port.link}", flush=True)
    if video is not None:
        print(f"camera: {video.url}", flush=True)
    print(f"testbed: {loaded.servo.name}, protocol {loaded.servo.protocol}.0, {baud} baud; Ctrl-C ends it", flush=True)
    ask_for_priority()
    try:
        testbed.spin(lambda: bool(stop) or time.monotonic() >= end, orders)
    finally:
        testbed.close()
        print(f"testbed: stopped; {testbed.bus.received} packets; {rig.skipped:.2f} s of physics skipped", flush=True)


class InputLines:
    """Lines of standard input, without ever waiting for one."""

    def __init__(self) -> None:
        self._open, self._rest = sys.stdin is not None, b""

    def new(self) -> list[str]:
        """Lines that came since the last call, without empty ones."""
        if not self._open or not select.select([sys.stdin], [], [], 0)[0]:
            return []
        data = os.read(sys.stdin.fileno(), 4096)
        self._open = bool(data)
        *whole, self._rest = (self._rest + data).split(b"\n")
        return [text for line in whole if (text := line.decode(errors="replace").strip())]


def _without_ros(arguments: list[str]) -> list[str]:
    """What stands before or after `--ros-args ... --`, so that launch files may start the testbed like a node."""
    if "--ros-args" not in arguments:
        return arguments
    at = arguments.index("--ros-args")
    rest = arguments[at + 1 :]
    return arguments[:at] + (rest[rest.index("--") + 1 :] if "--" in rest else [])


if __name__ == "__main__":
    main()
