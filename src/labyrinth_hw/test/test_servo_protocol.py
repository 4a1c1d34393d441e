# SPDX-License-Identifier: Apache-2.0
"""The real Dynamixel SDK and our bus, talking to emulated servos over a real pseudo-terminal."""

import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler

from labyrinth_hw.bus_time import BLOCKS, bytes_per_cycle, cycle_time
from labyrinth_hw.control_tables import MODELS, servo_model
from labyrinth_hw.errors import BusError, InputError, PortError
from labyrinth_hw.motors import Motor
from labyrinth_hw.registers import Register
from labyrinth_hw.serial_line import Port
from labyrinth_hw.servo_bus import ServoBus
from labyrinth_hw.testbed.live import LiveTestbed
from labyrinth_hw.testbed.packets import READ, Stream, crc16, status
from labyrinth_hw.testbed.parameters import HEALTHY
from labyrinth_hw.testbed.rig import LiveRig

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
    servos.set_mode("motor_x", torque_share=0.5)
    servos.close()


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
    packets = list(Stream(1).feed(bytes(broken) + whole))
    assert [p.intact for p in packets] == [False, True]
    assert packets[1].code == READ


def test_status_packets_stuff_the_header_pattern() -> None:
    packet = status(2, 1, 0, b"\xff\xff\xfd\x00")
    assert b"\xff\xff\xfd\xfd\x00" in packet[7:]
