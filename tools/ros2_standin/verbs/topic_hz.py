# SPDX-License-Identifier: Apache-2.0
"""`ros2 topic hz`: how often messages come."""

import argparse
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

WINDOW_SIZE = 10000


@dataclass
class Rate:
    """Spacing of one topic's messages, over a window."""

    window: int
    last: int | None = None  # ns
    fresh: bool = False
    steps: deque[int] = field(default_factory=deque)  # ns

    def add(self, now: int) -> None:
        if self.last is not None and now >= self.last:
            self.steps.append(now - self.last)
            self.fresh = True
            if len(self.steps) > self.window:
                self.steps.popleft()
        elif self.last is not None:
            self.steps.clear()  # the clock went back
        self.last = now

    def figures(self) -> tuple[float, float, float, float, int] | None:
        """Rate in Hz; smallest, largest step and standard deviation in s; steps. None when nothing new came."""
        if not self.fresh:
            return None
        self.fresh = False
        steps = np.array(self.steps) * 1e-9
        mean = float(steps.mean())
        return 1 / mean if mean > 0 else 0.0, float(steps.min()), float(steps.max()), float(steps.std()), len(steps)


def hz(node: Node, kinds: dict[str, Any], args: argparse.Namespace) -> None:
    keep: Callable[[Any], Any] = eval(f"lambda m: ({args.filter_expr})") if args.filter_expr else lambda m: True
    rates = {topic: Rate(args.window_size) for topic in kinds}

    def count(message: Any, rate: Rate) -> None:
        now = time.time_ns() if args.use_wtime else node.get_clock().now().nanoseconds
        if keep(message) and now > 0:
            rate.add(now)

    for topic, kind in kinds.items():
        node.create_subscription(kind, topic, lambda m, rate=rates[topic]: count(m, rate), qos_profile_sensor_data)
        if len(kinds) > 1:
            print(f"Subscribed to [{topic}]")
    node.create_timer(1.0, lambda: _print(rates), clock=rclpy.clock.Clock())
    rclpy.spin(node)


def _print(rates: dict[str, Rate]) -> None:
    figures = {topic: f for topic, rate in rates.items() if (f := rate.figures()) is not None}
    if len(rates) == 1:
        for rate, low, high, deviation, window in figures.values():
            print(
                f"average rate: {rate:.3f}\n"
                f"\tmin: {low:.3f}s max: {high:.3f}s std dev: {deviation:.5f}s window: {window}"
            )
    elif figures:
        _print_table(figures)


def _print_table(figures: dict[str, tuple[float, float, float, float, int]]) -> None:
    header = ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
    rows = [[t, f"{f[0]:.3f}", f"{f[1]:.3f}", f"{f[2]:.3f}", f"{f[3]:.5f}", str(f[4])] for t, f in figures.items()]
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    print("   ".join(name.center(width) for name, width in zip(header, widths, strict=True)))
    print("=" * (sum(widths) + 3 * (len(header) - 1)))
    for row in rows:
        print("   ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)))
    print()


def _positive_int(text: str) -> int:
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError("value must be a positive integer")
    return int(text)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-w",
        "--window",
        dest="window_size",
        metavar="WINDOW",
        type=_positive_int,
        default=WINDOW_SIZE,
        help=f"window size, in # of messages, for calculating rate (default: {WINDOW_SIZE})",
    )
    parser.add_argument("--filter", dest="filter_expr", metavar="EXPR", help="only measure messages matching EXPR")
    parser.add_argument("--wall-time", dest="use_wtime", action="store_true", help="calculates rate using wall time")
