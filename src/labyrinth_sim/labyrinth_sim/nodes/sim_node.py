# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulation as a ROS node, with the topics of the real rig."""

import signal
import sys
import time

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from labyrinth_msgs.msg import BallEvent, BallState
from labyrinth_msgs.srv import LoadModel
from labyrinth_sim.ball import ON_BOARD, OVER_THE_RIM, BallGame
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.nodes.waiting import waiting
from labyrinth_sim.stepper import Stepper

RELIABLE = QoSProfile(depth=50)
CATCH_UP = 0.25  # s; a longer hiccup is skipped rather than caught up


class SimNode(Node):
    """Runs one model in real time, or at a multiple of it, and publishes what its sensors see."""

    def __init__(self) -> None:
        super().__init__("sim_node")
        self._declare("model", "labyrinth", "name or path of the model [-]", read_only=False)
        self._declare("namespace", "/sim", "prefix of the topics [-]")
        self._declare("rate", 0.0, "samples per second; 0 for the rig's [Hz]", low=0.0, high=1000.0)
        self._declare("real_time_factor", 1.0, "seconds simulated per second; /clock is published where not 1 [1]",
                      low=0.01, high=100.0)  # fmt: skip
        self._declare("seed", 0, "seed of the sensors' noise [-]", low=0, high=2**31 - 1)
        self._declare("noise", 0.0, "standard deviation of the measured angles' noise [rad]", low=0.0, high=0.1)
        prefix = str(self.get_parameter("namespace").value).rstrip("/")
        rate = float(self.get_parameter("rate").value)
        self._factor = float(self.get_parameter("real_time_factor").value)
        self._noise = float(self.get_parameter("noise").value)
        self._random = np.random.default_rng(int(self.get_parameter("seed").value))
        self._rate = rate
        self._loaded = 0
        self._model: Model
        self._stepper: Stepper
        self._use(load_model(str(self.get_parameter("model").value)))
        topics = self._model.rig.topics
        qos = {"qos_profile": RELIABLE, "qos_overriding_options": QoSOverridingOptions.with_default_policies()}
        self._states = self.create_publisher(JointState, f"{prefix}/{topics['states']}", **qos)
        self._balls = self.create_publisher(BallState, f"{prefix}/{topics['ball']}", **qos)
        self._events = self.create_publisher(BallEvent, f"{prefix}/{topics['ball_event']}", **qos)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clocks = self.create_publisher(ClockMessage, "/clock", 10) if self._factor != 1.0 else None
        self._commands = self.create_subscription(JointState, f"{prefix}/{topics['commands']}", self._command, **qos)
        self.create_service(Trigger, f"{prefix}/reset", self._reset)
        self.create_service(Trigger, f"{prefix}/supply_ball", self._supply)
        self.create_service(LoadModel, f"{prefix}/load_model", self._load)
        self.add_on_set_parameters_callback(self._changed)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(min(self._stepper.step / self._factor, 0.02), self._tick, clock=steady)
        self.create_timer(1.0, self._report, clock=steady)
        self._began, self._epoch = time.monotonic(), self.get_clock().now().nanoseconds
        self._done = 0  # samples simulated since the beginning
        self._skipped, self._late, self._refused = 0.0, 0, 0
        self.get_logger().info(f"Simulates '{self._model.name}' at {1 / self._stepper.step:g} Hz under {prefix}.")

    def _declare(
        self,
        name: str,
        default: object,
        text: str,
        low: float | None = None,
        high: float | None = None,
        read_only: bool = True,
    ) -> None:
        about = ParameterDescriptor(description=text, read_only=read_only)
        if low is not None and high is not None:
            if isinstance(default, int):
                about.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
            else:
                about.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        self.declare_parameter(name, default, about)

    def _use(self, model: Model, keep_pose: bool = False) -> None:
        """Takes over a model; an unusable one raises and leaves the old one running."""
        stepper = Stepper(model, 1.0 / self._rate if self._rate else None)
        channels = model.rig.command_channels
        if keep_pose:
            if channels != self._model.rig.command_channels or stepper.step != self._stepper.step:
                raise InputError(f"'{model.name}' has other command channels or another rate than the running model.")
            self._last = stepper.reset(self._pose())
        else:
            self._target = np.zeros(len(channels))
            self._last = stepper.reset()
        self._model, self._stepper = model, stepper
        self._lost = False
        self._game = _game(stepper)

    def _pose(self) -> dict[str, float]:
        now = dict(zip(self._stepper.signals, self._last, strict=True))
        positions = [m.signal for m in self._model.rig.measured if m.quantity == "position"]
        ball = ["ball_x", "ball_y"] if self._stepper.with_ball and not self._lost else []
        return {name: float(now[name]) for name in positions + ball}

    def _command(self, message: JointState) -> None:
        channels = self._model.rig.command_channels
        names, angles = list(message.name), np.array(message.position, float)
        unknown = [n for n in names if n not in channels]
        if not names or unknown or len(names) != len(angles) or not np.isfinite(angles).all():
            self._refused += 1
            self.get_logger().warning(
                f"Refused a command with names {names} and {len(angles)} positions; expected finite positions "
                f"(rad) for some of {', '.join(channels)}.",
                throttle_duration_sec=1.0,
            )
            return
        for name, angle in zip(names, angles, strict=True):
            axis = self._model.rig.axes[channels.index(name)]
            self._target[channels.index(name)] = np.clip(angle, *axis.limits)

    def _hear(self) -> None:
        """Takes all commands that wait: the executor takes one at a time, and what piled up once would stay late."""
        for message in waiting(self._commands):
            self._command(message)

    def _tick(self) -> None:
        """Simulates up to now; counts samples from the beginning, so that nothing drifts."""
        self._hear()
        step = self._stepper.step
        passed = (time.monotonic() - self._began) * self._factor - self._skipped
        due = int(passed / step) - self._done
        most = max(1, int(CATCH_UP * max(self._factor, 1.0) / step))
        if due > most:
            self._skipped += (due - most) * step
            self._late += due - most
            due = most
        for _ in range(due):
            self._sample()

    def _sample(self) -> None:
        self._done += 1
        try:
            self._last = self._stepper.advance(self._target)
        except InputError as error:
            self.get_logger().error(f"{error} Starts anew from rest.")
            self._last = self._stepper.reset()
        stamp = self._stamp()
        if self._clocks:
            self._clocks.publish(ClockMessage(clock=stamp))
        self._publish_joints(stamp)
        if self._stepper.with_ball:
            self._publish_ball(stamp)

    def _stamp(self) -> Time:
        skipped = self._skipped if self._factor == 1.0 else 0.0
        start = self._epoch if self._factor == 1.0 else 0
        nanoseconds = start + round((self._done * self._stepper.step + skipped) * 1e9)
        return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def _publish_joints(self, stamp: Time) -> None:
        message = JointState()
        message.header.stamp = stamp
        seen = dict(zip(self._stepper.signals, self._last, strict=True))
        by_joint: dict[str, dict[str, float]] = {}
        for m in self._model.rig.measured:
            by_joint.setdefault(m.joint, {})[m.quantity] = float(seen[m.signal])
        shafts = {axis.joint: axis.command for axis in self._model.rig.axes}
        for joint in sorted(by_joint, key=lambda joint: joint not in shafts):  # as the rig has them: motors first
            numbers = by_joint[joint]
            message.name.append(shafts.get(joint, joint))
            noise = self._noise * self._random.standard_normal() if self._noise else 0.0
            message.position.append(numbers.get("position", float("nan")) + noise)
            message.velocity.append(numbers.get("velocity", float("nan")))
            message.effort.append(numbers.get("torque", float("nan")))
        self._states.publish(message)

    def _publish_ball(self, stamp: Time) -> None:
        message = BallState(visible=not self._lost)
        message.header.stamp, message.header.frame_id = stamp, "board"
        message.x, message.y = (float(v) for v in self._last[-2:])
        if self._game and not self._lost:
            hole = int(self._game.loss(self._game.position(self._stepper.qpos)))
            if hole != ON_BOARD:
                self._lost, message.visible = True, False
                self._event(stamp, BallEvent.LOST, -1 if hole == OVER_THE_RIM else hole)
        self._balls.publish(message)

    def _event(self, stamp: Time, kind: int, hole: int) -> None:
        event = BallEvent(kind=kind, hole=hole)
        event.header.stamp, event.header.frame_id = stamp, "board"
        self._events.publish(event)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._target[:] = 0.0
        self._last, self._lost = self._stepper.reset(), False
        response.success, response.message = True, f"'{self._model.name}' starts anew from rest."
        return response

    def _supply(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._stepper.supply_ball()
        except InputError as error:
            response.success, response.message = False, str(error)
            return response
        self._lost = False
        self._event(self._stamp(), BallEvent.SUPPLIED, -1)
        response.success, response.message = True, "The ball is at the start."
        return response

    def _load(self, request: LoadModel.Request, response: LoadModel.Response) -> LoadModel.Response:
        response.success, response.message = self._try(request.model)
        return response

    def _try(self, name: str) -> tuple[bool, str]:
        try:
            self._use(load_model(name), keep_pose=True)
        except InputError as error:
            return False, f"{error} '{self._model.name}' goes on."
        self._loaded += 1
        self._report()  # whoever compares should know before the next trial
        text = f"Simulates '{self._model.name}' now."
        self.get_logger().info(text)
        return True, text

    def _changed(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "model":
                done, text = self._try(str(parameter.value))
                if not done:
                    return SetParametersResult(successful=False, reason=text)
        return SetParametersResult(successful=True)

    def _report(self) -> None:
        behind = self._late > 0
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if behind else DiagnosticStatus.OK,
            name=f"{self.get_name()}: simulation",
            message=f"{self._late} samples were skipped" if behind else "in time",
            hardware_id="mujoco",
        )
        numbers = {
            "model": self._model.name,
            "model file": self._model.path or "",
            "models loaded": self._loaded,
            "samples": self._done,
            "samples skipped": self._late,
            "commands refused": self._refused,
            "real-time factor": self._factor,
        }
        status.values = [KeyValue(key=key, value=str(value)) for key, value in numbers.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        self._late = 0


def _game(stepper: Stepper) -> BallGame | None:
    """The rules by which the ball is lost; None on a rig that is no labyrinth."""
    try:
        return BallGame.of(stepper.mj) if stepper.with_ball else None
    except InputError:
        return None


def main() -> None:
    """Runs the node until it is interrupted; exit code 2 for bad parameters."""
    # rclpy's own handlers would close the context under a callback that is still publishing.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        node = SimNode()
    except Exception as error:  # parameters that ROS or we refuse
        print(f"sim_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        sys.exit(2)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
