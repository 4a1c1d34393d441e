# SPDX-License-Identifier: Apache-2.0
"""How soon a sample is judged, and what following the gap costs.

Publishes both sides at 100 Hz, four positions each, in marked trials, and measures the time from sending the later of
two samples to receiving its judged value on /srg/tunnel, two hops over DDS included, while both sides are recorded.

    python benchmarks/live.py --trials 5 --json out.json
"""

import argparse
import json
import os
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.nodes.messages import nanoseconds, to_time
from eps_tunnel_analysis.nodes.rig_processes import executable, own_domain
from eps_tunnel_analysis.processes import Processes
from labyrinth_msgs.msg import Trial, TunnelSample
from labyrinth_msgs.srv import Record

JOINTS = ["motor_x", "motor_y", "board_x", "board_y"]
STEP = 10_000_000  # ns
DURATION = 12.0  # s, of a trial
BETWEEN = 100  # samples from trial to trial
BARS = {"live_latency_ms_p99": 20.0, "cpu_share": 0.25}


class Sides(Node):
    """Publishes both sides and notes when each sample was sent and when it came back judged."""

    def __init__(self) -> None:
        super().__init__("live_benchmark")
        self.states = [self.create_publisher(JointState, f"/{side}/joint_states", 50) for side in ("real", "sim")]
        self.marks = [self.create_publisher(Trial, f"/{side}/trial", 10) for side in ("real", "sim")]
        self.create_subscription(TunnelSample, "/srg/tunnel", self._judged, 100)
        self.recorder = self.create_client(Record, "/record")
        self.sent: dict[int, float] = {}
        self.latencies: list[float] = []
        self._random = np.random.default_rng(1)

    def _judged(self, message: TunnelSample) -> None:
        sent = self.sent.get(nanoseconds(message.header.stamp))
        if sent is not None:
            self.latencies.append(time.monotonic() - sent)

    def sample(self, stamp: int) -> None:
        """Both sides at once."""
        value = 0.05 * np.sin(stamp * 6e-9)
        for publisher in self.states:
            position = value + self._random.normal(0.0, 0.001, 4)
            message = JointState(name=JOINTS, position=position.tolist())
            message.header.stamp = to_time(stamp)
            self.sent[stamp] = time.monotonic()
            publisher.publish(message)

    def mark(self, phase: int, stamp: int, trial: int) -> None:
        """On both sides."""
        for publisher in self.marks:
            message = Trial(phase=phase, sequence="sine", sequence_hash="b" * 64, trial=trial, duration=DURATION)
            message.header.stamp = to_time(stamp)
            publisher.publish(message)

    def play(self, trials: int) -> None:
        """From absolute deadlines, as the player does."""
        begin, first = time.monotonic(), self.get_clock().now().nanoseconds
        samples = round(DURATION * 1e9) // STEP
        step = 0
        for trial in range(trials):
            for within in range(-BETWEEN, samples + 1):
                time.sleep(max(0.0, begin + step * STEP * 1e-9 - time.monotonic()))
                stamp = first + step * STEP
                if within == 0:
                    self.mark(Trial.START, stamp, trial)
                self.sample(stamp)
                step += 1
            self.mark(Trial.END, stamp, trial)


def cpu_seconds(pid: int) -> float:
    """User and system time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(trials: int, folder: Path) -> dict[str, float]:
    """The figures."""
    (folder / "logs").mkdir()
    with own_domain() as domain:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        with Processes(folder / "logs", {**os.environ, "PYTHONUNBUFFERED": "1"}) as processes:
            processes.start("analysis_node", [executable("eps_tunnel_analysis", "analysis_node")])
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            node, executor = Sides(), SingleThreadedExecutor()
            executor.add_node(node)
            spinning = threading.Thread(target=executor.spin, daemon=True)
            spinning.start()
            while not node.recorder.service_is_ready():
                processes.check()
                time.sleep(0.1)
            asked = node.recorder.call_async(
                Record.Request(start=True, folder=str(folder / "bags"), label="sine", sides=["real", "sim"])
            )
            while not asked.done():
                time.sleep(0.05)
            pid = processes._running["analysis_node"].pid
            began, used = time.monotonic(), cpu_seconds(pid)
            node.play(trials)
            time.sleep(0.5)
            wall, used = time.monotonic() - began, cpu_seconds(pid) - used
            executor.shutdown()
            spinning.join()
            latencies = 1000 * np.array(node.latencies)
            node.destroy_node()
            rclpy.try_shutdown()
    return {
        "live_latency_ms_p50": float(np.percentile(latencies, 50)),
        "live_latency_ms_p99": float(np.percentile(latencies, 99)),
        "live_latency_ms_max": float(latencies.max()),
        "judged_share": len(latencies) / (trials * (round(DURATION * 1e9) // STEP + 1)),
        "cpu_share": used / wall,
    }


def main() -> None:
    """Measures and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(arguments.trials, Path(folder))
    print(
        f"{arguments.trials} trials of {DURATION:g} s on both sides at 100 Hz; load of the machine before: {load:.1f}"
    )
    for key, value in figures.items():
        bar = f"  bar: {BARS[key]:g}" if key in BARS else ""
        print(f"{key:24s}{value:10.3f}{bar}")
    if arguments.json:
        arguments.json.write_text(json.dumps({**figures, "load": load}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
