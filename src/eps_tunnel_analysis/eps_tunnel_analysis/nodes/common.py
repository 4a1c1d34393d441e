# SPDX-License-Identifier: Apache-2.0
"""What every node here needs: parameters with description, range and unit, a clean start and a clean end."""

import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import rclpy
from pydantic import ValidationError
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.nodes.start import start_ros

SIDES = ("real", "sim")
# Declared by rclpy itself, some only after the node was made.
_BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")
POLL_PERIOD = 0.05  # s between two looks at timers and services of a node that polls
CALLBACKS_EACH = 3  # callbacks at each look


class TunnelNode(Node):
    """A node with declared parameters that can be asked to stop.

    Attributes:
        stopping: set by SIGINT and SIGTERM; long work watches it.
        exit_code: of the process; set it with `stopping` to end from inside.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.stopping = threading.Event()
        self.exit_code = 0
        self._complaints: list[str] = []

    def parameter(
        self, name: str, default: Any, text: str, unit: str = "-", low: float | None = None, high: float | None = None,
        changes: bool = False,
    ) -> Any:  # fmt: skip
        """Declares a parameter and returns its value; errors are kept for `check_parameters`.

        Args:
            changes: whether it may be set while the node runs; its users then read the value again.
        """
        descriptor = ParameterDescriptor(description=f"{text} [{unit}]", read_only=not changes)
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

    @property
    def full_name(self) -> str:
        """The node's name with its namespace, as diagnostics are called."""
        return str(self.get_fully_qualified_name()).strip("/")

    def say(self, success: bool, message: str) -> None:
        """Logs how something ended."""
        if success:  # rclpy knows a call by its line, and allows each one severity
            self.get_logger().info(message)
        else:
            self.get_logger().error(message)

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
        sides = tuple(self.parameter("sides", list(SIDES), "Sides that take part; topics lie under SIDE/") or ())
        for side in sides:
            if side not in SIDES:
                self.complain(unknown_name("side", side, SIDES))
        if not sides or len(set(sides)) != len(sides):
            self.complain(f"Parameter 'sides': expected one or both of {', '.join(SIDES)}, got {list(sides)}.")
        return sides

    @property
    def busy(self) -> bool:
        """True while something must be finished before the process may end."""
        return False

    @property
    def poll_period(self) -> float:
        """s between two calls of `poll`; 0 for a node that needs none."""
        return 0.0

    def poll(self) -> None:
        """Handles what has arrived outside the executor."""

    def close(self) -> None:
        """Closes files. Called once, after the last callback."""


def _polled(node: TunnelNode, executor: SingleThreadedExecutor) -> None:
    """Polls for POLL_PERIOD, then serves callbacks. A wake-up of the executor costs more than several polls."""
    for _ in range(max(1, round(POLL_PERIOD / node.poll_period))):
        node.poll()
        time.sleep(node.poll_period)
    for _ in range(CALLBACKS_EACH):
        executor.spin_once(timeout_sec=0.0)


NodeT = TypeVar("NodeT", bound=TunnelNode)


def run_node(program: str, about: str, make: Callable[[], NodeT], args: list[str] | None = None) -> int:
    """Spins a node until it stops itself or SIGINT or SIGTERM comes.

    Args:
        program, about: its name, and one sentence for --help.
        args: the program's words, without its name; those of this process if None.

    Returns the exit code: the node's own, or 2 for bad input with the complaints on stderr.
    """
    signals: list[int] = []
    handlers = {
        number: signal.signal(number, lambda n, _: signals.append(n)) for number in (signal.SIGINT, signal.SIGTERM)
    }
    node: NodeT | None = None
    try:
        # rclpy's own handlers would take the context away before the last mark is published and the bags are closed.
        start_ros(program, about, sys.argv[1:] if args is None else args)
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # Wakes the executor so that a signal is seen; a timeout on each spin would cost more.
        if not node.poll_period:
            node.create_timer(0.1, lambda: None, clock=Clock(clock_type=ClockType.STEADY_TIME))  # ROS time may stand
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
    except rclpy_implementation.RCLError as error:  # what rcl refuses only with the node, as a wrong name
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    except ExternalShutdownException:
        return 0
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        for number, handler in handlers.items():
            signal.signal(number, handler)


Handle: TypeAlias = ServerGoalHandle[Any, Any, Any]
ResultT = TypeVar("ResultT")


def attempted(what: str, work: Callable[[], ResultT], refused: Callable[[str], ResultT]) -> ResultT:
    """The result of some work, or `refused` of the reason why it could not be done.

    Args:
        what: the work in words, as "diagnosis".
        work: may raise pydantic's ValidationError for an invalid goal.
    """
    try:
        return work()
    except ValidationError as error:
        from eps_tunnel_analysis.tasks import task_complaint  # takes a while, which nodes without tasks do without

        return refused(task_complaint(error))
    except Exception as error:  # a thread that died silently would leave the node busy for ever
        return refused(f"The {what} failed: {error!r}.")


class OneGoal:
    """Accepts a goal if no other is running, and refuses it otherwise.

    Args:
        kind, name: of the action.
        refusal: message for a goal that is refused.
        work: carries out a goal; ends with `handle.execute` of a function that calls `settle`.
    """

    def __init__(
        self, node: TunnelNode, kind: Any, name: str, refusal: Callable[[Any], str], work: Callable[[Handle], None]
    ) -> None:
        self._node, self._refusal, self._name = node, refusal, name.strip("/")
        self._working = threading.Lock()
        self._thread: threading.Thread | None = None
        self._server = ActionServer(
            node, kind, name, lambda _: kind.Result(), goal_callback=self._goal,
            handle_accepted_callback=lambda handle: self._start(lambda: work(handle)),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    @property
    def busy(self) -> bool:
        """While a job is running."""
        return self._working.locked()

    def begin(self, work: Callable[[], None]) -> bool:
        """Starts work without a goal, which calls `free` at its end; False if a job is running."""
        if not self._working.acquire(blocking=False):
            return False
        self._start(work)
        return True

    def stopped(self, handle: Handle) -> bool:
        """Whether a goal is to end early."""
        return bool(handle.is_cancel_requested) or self._node.stopping.is_set()

    def settle(self, handle: Handle, success: bool) -> None:
        """Ends a goal, and accepts the next one."""
        try:
            if success:
                handle.succeed()
            elif handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
        finally:
            self.free()

    def free(self) -> None:
        """Accepts the next goal."""
        self._working.release()

    def close(self) -> None:
        """Waits for the end of the current job; `node.stopping` cancels it."""
        self._server.destroy()
        if self._thread is not None:
            self._thread.join()

    def _goal(self, goal: Any) -> GoalResponse:
        if self._node.stopping.is_set() or not self._working.acquire(blocking=False):
            self._node.get_logger().warning(self._refusal(goal))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _start(self, work: Callable[[], None]) -> None:
        # A thread of its own: a blocking callback would need a multi-threaded executor, which takes twice the time of
        # this one for every message that comes in.
        self._thread = threading.Thread(target=work, name=self._name)
        self._thread.start()
