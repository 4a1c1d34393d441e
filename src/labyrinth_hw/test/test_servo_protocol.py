# SPDX-License-Identifier: Apache-2.0
"""The real Dynamixel SDK and our bus, talking to emulated servos over a real pseudo-terminal."""

import itertools
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler

from labyrinth_hw.bus import BLOCKS, ServoBus, block, bytes_per_cycle, cycle_time
from labyrinth_hw.control_tables import MODELS, Register, servo_model
from labyrinth_hw.errors import BusError, InputError, PortError
from labyrinth_hw.motors import Motor, motor_state
from labyrinth_hw.serial_port import Port
from labyrinth_hw.settings import MotorSection
from labyrinth_hw.testbed.live import LiveRig, LiveTestbed
from labyrinth_hw.testbed.quantities import HEALTHY
from labyrinth_hw.testbed.servo_emulator import READ, InstructionStream, crc16, status_packet

BAUD = 1_000_000


@pytest.fixture
def serve(tmp_path: Path) -> Iterator:
    """Starts a testbed with servos of a model in a thread; returns it and the port's path."""
    running = []

    def start(model: str) -> tuple[LiveTestbed, str]:
        rig = LiveRig(HEALTHY, servo_model(model), 1, time.monotonic())
        testbed = LiveTestbed(rig, tmp_path / model, BAUD, 115_200, 1)
        stop = threading.Event()
        thread = threading.Thread(target=testbed.spin, args=(stop.is_set,), daemon=True)
        thread.start()
        running.append((stop, thread, testbed))
        return testbed, str(tmp_path / model / "servos")

    yield start
    for stop, thread, testbed in running:
        stop.set()
        thread.join()
        testbed.close()


def bus(path: str, model: str, **changes: object) -> ServoBus:
    motors = [Motor("motor_x", 1, servo_model(model)), Motor("motor_y", 2, servo_model(model))]
    return ServoBus(path, BAUD, changes.pop("motors", motors), patience=0.2, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("model", sorted(MODELS))
@pytest.mark.realtime
def test_every_model_connects_moves_and_tells_its_state(serve, model: str) -> None:
    _, path = serve(model)
    servos = bus(path, model)
    servos.connect()
    servos.set_torque(True)
    servos.write_goals({"motor_x": 0.05, "motor_y": -0.03})
    deadline = time.monotonic() + 90.0
    states = servos.read_states()
    while time.monotonic() < deadline and abs(states["motor_x"].position - 0.05) > 0.008:
        states = servos.read_states()
    assert states["motor_x"].position == pytest.approx(0.05, abs=0.008)
    assert states["motor_y"].position == pytest.approx(-0.03, abs=0.008)
    assert states["motor_x"].voltage == pytest.approx(12.0, abs=0.2)
    assert servos.read("motor_x", "goal_position") == pytest.approx(0.05, abs=servo_model(model).tick)
    with servos.torque_disabled():
        assert servos.read("motor_x", "torque_enable") == 0
    assert servos.read("motor_x", "torque_enable") == 1
    servos.prepare("motor_x")
    servos.close()


def turned(model: str) -> Motor:
    """Mounted the other way round."""
    return MotorSection(id=1, model=model, sign=-1, zero_deg=2.0).motor("motor_x")


@pytest.mark.parametrize("model", ["MX-64", "XL330-M288"])
@pytest.mark.realtime
def test_a_servo_mounted_the_other_way_round_goes_where_the_joint_shall(serve, model: str) -> None:
    _, path = serve(model)
    tick = servo_model(model).tick
    servos = bus(path, model, motors=[turned(model)])
    servos.connect()
    servos.set_torque(True)
    servos.write_goals({"motor_x": 0.05})
    assert servos.read("motor_x", "goal_position") == pytest.approx(math.radians(2.0) - 0.05, abs=tick)
    deadline = time.monotonic() + 90.0
    joint, before = servos.read_states()["motor_x"].position, math.inf
    while time.monotonic() < deadline and (abs(joint - 0.05) > 0.008 or abs(joint - before) > tick):
        time.sleep(0.05)  # it may pass its goal before it rests
        joint, before = servos.read_states()["motor_x"].position, joint
    assert joint == pytest.approx(0.05, abs=0.008)
    assert servos.read("motor_x", "present_position") == pytest.approx(math.radians(2.0) - 0.05, abs=0.01)
    servos.close()


@pytest.mark.parametrize("model", sorted(MODELS))
@pytest.mark.parametrize("sign", [1, -1])
def test_what_the_bytes_of_an_answer_mean_at_the_joint(model: str, sign: int) -> None:
    """The servo is at 0.3 rad, 0.1 rad from its joint's zero, turns at 1 rad/s and reports 0.2 (A or share)."""
    servo = servo_model(model)
    motor = MotorSection(id=1, model=model, sign=sign, zero_deg=math.degrees(0.1)).motor("motor_x")
    start, length = block(servo, BLOCKS[1])
    data = bytearray(length)
    units = {}
    for name, value in {"present_position": 0.3, "present_speed": 1.0, servo.effort_register: 0.2}.items():
        entry = servo.register(name)
        raw = entry.to_raw(value).to_bytes(entry.size, "little")
        data[entry.address - start : entry.address - start + entry.size] = raw
        units[name] = entry.unit
    state = motor_state(motor, bytes(data), 0, 0.0)
    assert state.position == pytest.approx(sign * 0.2, abs=units["present_position"])
    assert state.speed == pytest.approx(sign * 1.0, abs=units["present_speed"])
    effort = units[servo.effort_register] * servo.effort_per_unit
    assert state.effort == pytest.approx(sign * 0.2 * servo.effort_per_unit, abs=effort)


@pytest.mark.parametrize("model", ["MX-64", "MX-64-2"])
@pytest.mark.realtime
def test_sdk_functions_understand_the_emulated_servo(serve, model: str) -> None:
    testbed, path = serve(model)
    servo = servo_model(model)
    port, handler = Port(path, BAUD, 0.2), PacketHandler(float(servo.protocol))
    port.openPort()
    try:
        assert handler.ping(port, 1) == (servo.number, COMM_SUCCESS, 0)
        assert handler.ping(port, 9)[1] != COMM_SUCCESS
        led = servo.register("led").address
        assert handler.write1ByteTxRx(port, 1, led, 1) == (COMM_SUCCESS, 0)
        assert handler.read1ByteTxRx(port, 1, led) == (1, COMM_SUCCESS, 0)
        # Written by "reg write", in force only after "action".
        handler.regWriteTxRx(port, 1, led, 1, [0])
        assert handler.read1ByteTxRx(port, 1, led)[0] == 1
        handler.action(port, 0xFE)
        assert handler.read1ByteTxRx(port, 1, led)[0] == 0
        # A read-only register refuses, and the error says so.
        _, error = handler.write1ByteTxRx(port, 1, servo.register("present_temperature").address, 1)
        assert error & 0x7F == (0x08 if servo.protocol == 1 else 7)
        # Status return level 1: writes are not answered, reads are.
        handler.write1ByteTxRx(port, 1, servo.register("status_return_level").address, 1)
        assert handler.write1ByteTxRx(port, 1, led, 1)[0] != COMM_SUCCESS
        assert handler.read1ByteTxRx(port, 1, led) == (1, COMM_SUCCESS, 0)
        # A damaged answer is noticed.
        testbed.servo_line.bad_share = 1.0
        assert handler.read1ByteTxRx(port, 2, led)[1] != COMM_SUCCESS
        testbed.servo_line.bad_share = 0.0
        time.sleep(0.01)
        assert handler.read1ByteTxRx(port, 2, led) == (0, COMM_SUCCESS, 0)
        if servo.protocol == 2:
            assert handler.broadcastPing(port)[0] == {1: [servo.number, 45], 2: [servo.number, 45]}
    finally:
        port.closePort()


@pytest.mark.realtime
def test_missing_and_wrong_servos_are_told_with_what_was_found(serve) -> None:
    _, path = serve("MX-64")
    motors = [Motor("motor_x", 1, servo_model("MX-106")), Motor("motor_y", 7, servo_model("MX-64"))]
    with pytest.raises(BusError, match="missing motor_y; wrong model motor_x") as told:
        bus(path, "MX-64", motors=motors).connect()
    assert "id 1: model number 310" in str(told.value)
    assert "MX-106 (320)" in str(told.value)


@pytest.mark.realtime
def test_a_port_is_held_by_one_program_only(serve) -> None:
    _, path = serve("MX-64")
    first = bus(path, "MX-64")
    first.connect()
    with pytest.raises(PortError, match="in use by another program"):
        bus(path, "MX-64").connect()
    first.close()
    bus(path, "MX-64").connect()


def test_a_missing_port_is_told(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="does not exist"):
        bus(str(tmp_path / "nothing"), "MX-64").connect()


@pytest.mark.realtime
def test_one_percent_of_bad_packets_loses_no_reading(serve) -> None:
    testbed, path = serve("MX-64")
    servos = bus(path, "MX-64")
    servos.connect()
    testbed.servo_line.bad_share = 0.01
    for _ in range(600):
        servos.read_states()
        servos.write_goals({"motor_x": 0.0, "motor_y": 0.0})
    assert testbed.servo_line.damaged >= 3
    assert servos.counters.retried >= testbed.servo_line.damaged
    assert servos.counters.failed == 0


@pytest.mark.realtime
def test_a_silent_bus_raises_and_a_vanished_one_too(serve) -> None:
    testbed, path = serve("MX-64")
    servos = bus(path, "MX-64")
    servos.connect()
    servos.port.patience = 0.01
    testbed.servo_line.bad_share = 1.0
    with pytest.raises(BusError, match="did not answer in 3 tries"):
        servos.read_states()
    testbed.servo_line.port.unplug()
    with pytest.raises((PortError, BusError)):
        servos.read_states()
    with pytest.raises(PortError, match="does not exist"):
        bus(path, "MX-64").connect()


@pytest.mark.parametrize("model", ["MX-64", "XL330-M288"])
@pytest.mark.realtime
def test_an_alarm_switches_torque_off_and_is_told_with_its_bits(serve, model: str) -> None:
    testbed, path = serve(model)
    servos = bus(path, model)
    servos.connect()
    servos.set_torque(True)
    testbed.rig.servos[0].raise_alarm(0x20)
    assert servos.read_states()["motor_x"].alarm & 0x20
    assert servos.read("motor_x", "torque_enable") == 0
    assert "overload" in servo_model(model).shutdown[0x20]


def mode_of(testbed: LiveTestbed) -> int:
    return testbed.rig.servos[0].raw("operating_mode")


@pytest.mark.parametrize("model", ["XL330-M077", "MX-64-2", "XL430-W250"])
@pytest.mark.realtime
def test_no_operating_mode_is_written_that_was_not_stated(serve, model: str) -> None:
    testbed, path = serve(model)
    told = [Motor("motor_x", 1, servo_model(model), operating_mode=4), Motor("motor_y", 2, servo_model(model))]
    servos = bus(path, model)
    servos.connect()
    for mode in (3, 4):
        testbed.rig.servos[0].set("operating_mode", mode)
        servos.prepare("motor_x")
        assert mode_of(testbed) == mode
    testbed.rig.servos[0].set("operating_mode", 0)
    with pytest.raises(BusError, match="is in operating mode 0; expected 3"):
        servos.prepare("motor_x")
    assert mode_of(testbed) == 0
    servos.close()
    servos = bus(path, model, motors=told)
    servos.connect()
    servos.prepare("motor_x")
    assert mode_of(testbed) == 4
    servos.close()


@pytest.mark.realtime
def test_the_torque_limit_lies_in_registers_that_do_not_wear(serve) -> None:
    testbed, path = serve("XL330-M077")
    servos = bus(path, "XL330-M077")
    servos.connect()
    with pytest.raises(BusError, match=r"expected 5 \(current_based_position\) for torque_share"):
        servos.prepare("motor_x", 0.5)
    testbed.rig.servos[0].set("operating_mode", 5)
    servos.prepare("motor_x", 0.5)
    assert servos.read("motor_x", "goal_current") == pytest.approx(0.5 * 0.215 / 0.146, abs=1e-3)
    servos.close()
    testbed, path = serve("XL430-W250")
    before = bytes(testbed.rig.servos[0].memory[:64])
    servos = bus(path, "XL430-W250")
    servos.connect()
    after_connecting = bytes(testbed.rig.servos[0].memory[:64])
    servos.prepare("motor_x", 0.5)
    assert servos.read("motor_x", "goal_pwm") == pytest.approx(0.5, abs=2e-3)
    assert bytes(testbed.rig.servos[0].memory[:64]) == after_connecting
    changed = [at for at in range(64) if before[at] != after_connecting[at]]
    assert changed in ([], [servo_model("XL430-W250").register("return_delay").address])
    servos.close()


def test_protocols_do_not_mix_on_one_bus() -> None:
    with pytest.raises(InputError, match="same protocol"):
        ServoBus("nowhere", BAUD, [Motor("a", 1, servo_model("MX-64")), Motor("b", 2, servo_model("XL330-M288"))])


@pytest.mark.parametrize("model", sorted(MODELS))
def test_register_scales_are_inverse(model: str) -> None:
    for name, register in MODELS[model].registers.items():
        counts = {0, 1, min(register.to_raw(0.3), (1 << (8 * register.size)) - 1)}
        for raw in counts:
            assert register.to_raw(register.to_si(raw)) == raw, name


def test_registers_of_a_table_do_not_overlap() -> None:
    for model in MODELS.values():
        ends = sorted((r.address, r.address + r.size, name) for name, r in model.registers.items())
        for (_, end, name), (start, _, follower) in itertools.pairwise(ends):
            assert end <= start, f"{model.name}: {name} reaches into {follower}"


def test_negative_numbers_in_both_conventions() -> None:
    assert Register(0, 2, sign="two").to_si(0xFFFF) == -1
    assert Register(0, 2, sign="bit").to_si(0x400 | 5) == -5
    assert Register(0, 2, sign="bit").to_raw(-5) == 0x405


def test_bus_time_of_the_paper_s_servos_at_57600_baud() -> None:
    """By hand for DX-117: 2 reads of 8 + (6+4) bytes, one sync write of 8 + 2*3 bytes, ten bits each."""
    dx = servo_model("DX-117")
    assert bytes_per_cycle([dx, dx], BLOCKS[2]) == 2 * (8 + 10) + 14
    what, seconds = cycle_time([dx, dx], 57_600, 0.01)
    assert what == ("present_position", "present_speed")
    assert seconds == pytest.approx(0.00868, abs=1e-5)
    xl = servo_model("XL330-M288")
    with pytest.raises(InputError, match="Use at least"):
        cycle_time([xl, xl], 57_600, 0.01)


def test_crc_matches_the_manual_s_example() -> None:
    """The e-manual's ping packet of protocol 2.0 to id 1."""
    assert crc16(bytes.fromhex("FFFFFD0001030001")) == 0x4E19


def test_a_damaged_packet_does_not_swallow_the_next_one() -> None:
    whole = b"\xff\xff\x01\x04\x02\x24\x02" + bytes((~(1 + 4 + 2 + 0x24 + 2) & 0xFF,))
    broken = bytearray(whole)
    broken[5] ^= 0x10
    packets = list(InstructionStream(1).feed(bytes(broken) + whole))
    assert [p.intact for p in packets] == [False, True]
    assert packets[1].code == READ


def test_status_packets_stuff_the_header_pattern() -> None:
    packet = status_packet(2, 1, 0, b"\xff\xff\xfd\x00")
    assert b"\xff\xff\xfd\xfd\x00" in packet[7:]
