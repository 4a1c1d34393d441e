# SPDX-License-Identifier: Apache-2.0
"""What every node here needs: parameters with description, range and unit, a clean start and a clean end."""

import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from labyrinth_sim.errors import InputError, unknown_name

SIDES = ("real", "sim")
# Declared by rclpy itself, some only after the node was made.
_BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class TunnelNode(Node):
    """A node with declared parameters that can be told to stop.

    Attributes:
        stopping: set by SIGINT and SIGTERM; long work watches it.
        exit_code: what the process ends with; set it with `stopping` to end from inside.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.stopping = threading.Event()
        self.exit_code = 0
        self._complaints: list[str] = []

    def parameter(
        self, name: str, default: Any, text: str, unit: str = "-", low: float | None = None, high: float | None = None
    ) -> Any:
        """Declares a parameter and returns its value; what is wrong with it is kept for `check_parameters`."""
        descriptor = ParameterDescriptor(description=f"{text} [{unit}]", read_only=True)
        if low is not None and high is not None:
            if isinstance(default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
            else:
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        try:
            return self.declare_parameter(name, default, descriptor).value
        except ParameterException:
            given = self._parameter_overrides[name].value
            kind = Parameter(name, value=default).type_.name.lower().replace("_", " ")
            bounds = f" from {low:g} to {high:g}" if low is not None and high is not None else ""
            hint = f" Write {given}.0." if isinstance(default, float) and isinstance(given, int) else ""
            self._complaints.append(
                f"Parameter '{name}': expected {kind}{bounds} [{unit}], got {given!r}. {text}.{hint}"
            )
            return default

    def complain(self, complaint: str) -> None:
        """Keeps a complaint about the parameters for `check_parameters`."""
        self._complaints.append(complaint)

    def check_parameters(self) -> None:
        """Raises InputError with every wrong or unknown parameter. Call it once all are declared."""
        for name in self._parameter_overrides:
            if not self.has_parameter(name) and not name.startswith(_BUILT_IN):
                valid = [known for known in self._parameters if not known.startswith(_BUILT_IN)]
                if not any(name in complaint for complaint in self._complaints):
                    self._complaints.append(unknown_name("parameter", name, valid))
        if self._complaints:
            raise InputError(self._complaints)

    def sides(self) -> tuple[str, ...]:
        """The parameter `sides`, checked."""
        sides = tuple(self.parameter("sides", list(SIDES), "Sides that take part; topics lie under /SIDE") or ())
        for side in sides:
            if side not in SIDES:
                self.complain(unknown_name("side", side, SIDES))
        if not sides or len(set(sides)) != len(sides):
            self.complain(f"Parameter 'sides': expected one or both of {', '.join(SIDES)}, got {list(sides)}.")
        return sides

    @property
    def busy(self) -> bool:
        """True while something must be brought to its end before the process may go."""
        return False

    @property
    def poll_period(self) -> float:
        """s between two calls of `poll`; 0 for a node that needs none."""
        return 0.0

    def poll(self) -> None:
        """Looks for what has come outside the executor."""

    def close(self) -> None:
        """Brings files to their end. Called once, after the last callback."""


LOOK = 0.05  # s between two looks at timers and services of a node that polls
AT_ONCE = 3  # callbacks at each look


def _polled(node: TunnelNode, executor: SingleThreadedExecutor) -> None:
    """Polls for LOOK, then serves callbacks. A wake-up of the executor costs more than several polls."""
    for _ in range(max(1, round(LOOK / node.poll_period))):
        node.poll()
        time.sleep(node.poll_period)
    for _ in range(AT_ONCE):
        executor.spin_once(timeout_sec=0.0)


NodeT = TypeVar("NodeT", bound=TunnelNode)


def run_node(make: Callable[[], NodeT], args: list[str] | None = None) -> int:
    """Spins a node until it stops itself or SIGINT or SIGTERM comes.

    Returns the exit code: the node's own, or 2 for bad input with the complaints on stderr.
    """
    signals: list[int] = []
    handlers = {
        number: signal.signal(number, lambda n, _: signals.append(n)) for number in (signal.SIGINT, signal.SIGTERM)
    }
    node: NodeT | None = None
    try:
        # rclpy's own handlers would take the context away before the last mark is published and the bags are closed.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # Wakes the executor so that a signal is seen; a timeout on each spin would cost more.
        if not node.poll_period:
            node.create_timer(0.1, lambda: None)
        while not node.stopping.is_set() or node.busy:
            if node.poll_period:
                _polled(node, executor)
            else:
                executor.spin_once()
            if signals:
                node.stopping.set()
            if len(signals) > 1:
                break
        node.close()
        executor.shutdown(timeout_sec=2.0)
        return node.exit_code
    except InputError as error:
        for complaint in error.complaints:
            print(complaint, file=sys.stderr)
        return 2
    except rclpy_implementation.RCLError as error:  # a wrong --ros-args is told here
        print(error, file=sys.stderr)
        return 2
    except ExternalShutdownException:
        return 0
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        for number, handler in handlers.items():
            signal.signal(number, handler)
