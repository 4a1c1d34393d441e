# SPDX-License-Identifier: Apache-2.0
"""The real rig as a ROS node: the same topics as the simulation, under /real."""

import os
import signal
import sys
import threading
import time
import traceback
from types import FrameType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, JointState
from std_srvs.srv import Trigger

from labyrinth_hw.errors import HardwareError, InputError
from labyrinth_hw.hardware import Hardware, Measurement
from labyrinth_hw.health import hardware_health
from labyrinth_hw.nodes.messages import Stamps, annotated_image, ball_state, diagnostics, joint_state
from labyrinth_hw.priority import ask_for_priority
from labyrinth_hw.safety import Command, State
from labyrinth_hw.settings import load_hardware
from labyrinth_hw.vision import Sight, Vision
from labyrinth_msgs.msg import BallEvent, BallState

RELIABLE = QoSProfile(depth=50)
CALLBACKS, CONTROL = 9, 10  # real-time priorities
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class HwNode(Node):
    """Drives the servos in a thread of its own, one control period after the other, and publishes what they tell."""

    def __init__(self) -> None:
        super().__init__("hw_node")
        config = self._declare("config", "paper", "name or path of a config/hw/*.yaml [-]")
        prefix = str(self._declare("namespace", "/real", "prefix of the topics [-]")).rstrip("/")
        rate = self._declare("rate", 100.0, "control periods per second [Hz]", 10.0, 500.0)
        timeout = self._declare("command_timeout", 0.2, "age at which a command is old and motion stops [s]", 0.02, 5.0)
        patience = self._declare("connect_timeout", 5.0, "how long to wait for the ports to appear [s]", 0.0, 600.0)
        dry_run = self._declare("dry_run", False, "read everything but move nothing [-]")
        position_error = self._declare(
            "compensate_position_error", False, "correct goals by the calibrated error map [-]"
        )
        slack = self._declare("compensate_slack", False, "correct goals by the calibrated slack of the belt [-]")
        self._refuse_unknown_parameters()
        self._settings = load_hardware(str(config))
        self._timeout = float(timeout)
        self._period = 1.0 / float(rate)
        self.hardware = Hardware(
            self._settings, period=self._period, timeout=self._timeout, dry_run=bool(dry_run),
            position_error=bool(position_error), slack=bool(slack),
        )  # fmt: skip
        self._lock = threading.Lock()
        self._command: Command | None = None
        self._goals: dict[str, float] = {}
        self._orders: list[str] = []
        self._counts = {"cycles": 0, "late": 0, "silent": 0, "unseen": 0, "refused": 0}
        self._stamps = Stamps(lambda: int(self.get_clock().now().nanoseconds))
        self._piezo: int | None = None
        self._place: tuple[float, float] | None = None
        self._told = State.WAITING
        self._stop = threading.Event()
        self.exit_code = 0
        qos: dict[str, Any] = {
            "qos_profile": RELIABLE,
            "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
        }
        self._states = self.create_publisher(JointState, f"{prefix}/joint_states", **qos)
        self._events = self.create_publisher(BallEvent, f"{prefix}/ball_event", **qos)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._await_ports(float(patience))
        self.hardware.connect()
        self._thread = threading.Thread(target=self._control, name="control", daemon=True)
        self.create_subscription(JointState, f"{prefix}/joint_commands", self._commanded, **qos)
        self.create_service(Trigger, f"{prefix}/reset", self._reset)
        self.create_service(Trigger, f"{prefix}/supply_ball", self._supply)
        self.create_timer(1.0, self._report)
        motors = ", ".join(f"{m.name} ({m.model.name}, id {m.id})" for m in self._settings.motors)
        bus = self.hardware.bus
        self.get_logger().info(
            f"{motors} on {self._settings.servo_port}, {self._settings.baud} baud: {bus.cycle * 1e3:.1f} ms of bus "
            f"time in a period of {self._period * 1e3:g} ms.{' Dry run: nothing will move.' if dry_run else ''}"
        )
        self._vision = Vision(self._settings.camera) if self._settings.camera is not None else None
        self._sight: Sight | None = None
        self._eye_stamps = Stamps(lambda: int(self.get_clock().now().nanoseconds))
        self._eyes = threading.Thread(target=self._watch, name="vision", daemon=True)
        if self._vision is not None:
            self._balls = self.create_publisher(BallState, f"{prefix}/ball", **qos)
            self._pictures = self.create_publisher(Image, f"{prefix}/camera/annotated", 1)
            self._eyes.start()
        self._thread.start()

    def _declare(self, name: str, default: Any, text: str, low: float | None = None, high: float | None = None) -> Any:
        descriptor = ParameterDescriptor(description=text, read_only=True)
        if low is not None and high is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        return self.declare_parameter(name, default, descriptor).value

    def _await_ports(self, patience: float) -> None:
        """Wait until the ports' files exist: adapters and the emulated testbed may start after this node."""
        ports = [port for port in (self._settings.servo_port, self._settings.sensor_port) if port]
        deadline = time.monotonic() + patience
        while not all(map(os.path.exists, ports)) and time.monotonic() < deadline and rclpy.ok():
            time.sleep(0.05)

    def _refuse_unknown_parameters(self) -> None:
        unknown = [n for n in self._parameter_overrides if not self.has_parameter(n) and not n.startswith(BUILT_IN)]
        if unknown:
            valid = sorted(n for n in self._parameters if not n.startswith(BUILT_IN))
            raise InputError(f"Unknown parameters {unknown}. Available parameters: {', '.join(valid)}.")

    def _commanded(self, message: JointState) -> None:
        goals = dict(zip(message.name, message.position, strict=False))
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        age = self.get_clock().now().nanoseconds * 1e-9 - stamp if stamp else 0.0
        try:
            if len(message.name) != len(message.position):
                raise InputError(f"{len(message.name)} names but {len(message.position)} positions.")
            if age > self._timeout:
                raise InputError(f"Its stamp is {age:.3f} s old; more than {self._timeout:g} s is too late to obey.")
            self.hardware.safety.check(goals)
        except InputError as error:
            self._counts["refused"] += 1
            self.get_logger().warning(f"Refused a command: {error}", throttle_duration_sec=1.0)
            return
        with self._lock:
            self._goals.update(goals)
            if len(self._goals) == len(self._settings.motors):
                # Time spent on the way counts, where the sender's clock tells it.
                self._command = Command(dict(self._goals), time.monotonic() - max(0.0, age))

    def _control(self) -> None:
        if not ask_for_priority(CONTROL):
            self.get_logger().info("No real-time priority; on a busy machine control periods may come late.")
        due = time.monotonic()
        try:
            while not self._stop.is_set():
                self._obey_orders()
                with self._lock:
                    command = self._command
                measured = self.hardware.cycle(command)
                self._counts["cycles"] += 1
                if measured is None:
                    self._counts["silent"] += 1
                elif rclpy.ok():
                    self._publish(measured)
                self._tell_state()
                due += self._period
                left = due - time.monotonic()
                if left > 0:
                    self._stop.wait(left)
                elif left < -self._period:
                    self._counts["late"] += 1
                    due = time.monotonic()
        except BaseException as error:
            # Publishing while ROS shuts down fails too; that is an orderly end.
            if not self._stop.is_set() and rclpy.ok():
                self.get_logger().fatal(
                    f"The control thread ended, torque goes off:\n{''.join(traceback.format_exception(error))}"
                )
                self.exit_code = 1
                rclpy.try_shutdown()
        finally:
            self.hardware.close()

    def _obey_orders(self) -> None:
        with self._lock:
            orders, self._orders = self._orders, []
        for order in orders:
            try:
                if order == "reset":
                    self.get_logger().info(f"Reset: {self.hardware.reset()}.")
                else:
                    self.hardware.supply_ball()
                    self._event(BallEvent.SUPPLIED)
            except HardwareError as error:
                self.get_logger().error(f"{order}: {error}")

    def _publish(self, measured: Measurement) -> None:
        board = measured.board
        if self._settings.sensor_port is not None and not measured.whole:
            # A message without the board, or with where it was, would be taken for a measurement.
            self._counts["unseen"] += 1
        else:
            stamp = self._stamps.at(measured.stamp)
            self._states.publish(joint_state(measured, self._settings.potentiometers, stamp))
        if board is not None:
            if self._piezo is not None and board.piezo != self._piezo:
                self._event(BallEvent.LOST)
            self._piezo = board.piezo

    def _watch(self) -> None:
        vision = self._vision
        while vision is not None and not self._stop.is_set():
            sight = vision.next(0.2)
            if sight is None or not rclpy.ok():
                continue
            stamp = self._eye_stamps.at(sight.stamp)
            self._balls.publish(ball_state(sight, stamp))
            if sight.visible:
                self._place = (sight.x, sight.y)
            self._sight = sight
            if (image := annotated_image(sight, stamp)) is not None:
                self._pictures.publish(image)
            if (wanted := self._pictures.get_subscription_count() > 0) != vision.pictures.is_set():
                (vision.pictures.set if wanted else vision.pictures.clear)()

    def _event(self, kind: int) -> None:
        hole = self._settings.nearest_hole(self._place) if kind == BallEvent.LOST else -1
        event = BallEvent(kind=kind, hole=hole)
        event.header.stamp, event.header.frame_id = self.get_clock().now().to_msg(), "board"
        self._events.publish(event)

    def _tell_state(self) -> None:
        state = self.hardware.safety.state
        if state is not self._told:
            self._told = state
            if state is State.STOPPED:
                self.get_logger().error(f"Torque is off until reset: {'; '.join(self.hardware.safety.reasons)}.")
            elif not self.hardware.connected:
                self.get_logger().error(f"The servos are out of reach: {self.hardware.trouble}")
            else:
                self.get_logger().info(state.value)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._orders.append("reset")
            self._command = None
            self._goals.clear()
        response.success, response.message = True, "Torque stays off until the next valid command."
        return response

    def _supply(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.hardware.sensors_connected
        response.message = "The depot releases a ball." if response.success else "The sensor line is not connected."
        if response.success:
            with self._lock:
                self._orders.append("supply_ball")
        return response

    def _report(self) -> None:
        counts = {**self._counts, "clock steps": self._stamps.steps}
        health = hardware_health(self.hardware, counts, self._vision is not None, self._sight)
        now = self.get_clock().now().to_msg()
        name = f"{self.get_name()}: servos"
        self._diagnostics.publish(diagnostics(health, name, self._settings.servo_port, now))

    def close(self) -> None:
        """Torque off, ports closed."""
        self._stop.set()
        if self._vision is not None:
            self._eyes.join(timeout=2.0)
            self._vision.close()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)


def main() -> None:
    """Run the node until it is interrupted; exit code 2 for bad parameters or hardware that does not answer."""

    def terminated(number: int, frame: FrameType | None) -> None:
        rclpy.try_shutdown()

    ask_for_priority(CALLBACKS, children=True)  # before DDS starts its threads
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, terminated)
    try:
        node = HwNode()
    except Exception as error:  # parameters or hardware that ROS or we refuse
        print(f"hw_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        sys.exit(2)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(node.exit_code)


if __name__ == "__main__":
    main()
