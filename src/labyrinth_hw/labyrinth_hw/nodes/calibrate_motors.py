# SPDX-License-Identifier: Apache-2.0
"""`ros2 run labyrinth_hw calibrate_motors`: the positioning error of each servo and the slack of its belt.

Each axis moves through its range up and down; where the board rests, by the potentiometers, gives the map. Needs no
ROS, and the hardware node must not run at the same time. Writes a new YAML file: the given configuration with a
`compensation:` section.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml
from tqdm import tqdm

from labyrinth_hw import config
from labyrinth_hw.compensation import Compensation, measured_map
from labyrinth_hw.config import write_new
from labyrinth_hw.errors import HardwareError, InputError
from labyrinth_hw.hardware import Hardware, Measurement
from labyrinth_hw.safety import Goal, State
from labyrinth_hw.settings import CompensationSection, load_hardware

CYCLE = 0.01  # s
BEYOND_DEG = 1.0  # past the ends of the map; more than any belt's slack
LEAD = 0.1  # rad/s between two goals; thrown by a faster servo, the board would coast within the slack


def parser() -> argparse.ArgumentParser:
    """Options of `calibrate_motors`."""
    p = argparse.ArgumentParser(prog="calibrate_motors", description=__doc__.split("\n")[0].split(": ", 1)[1])
    p.add_argument("--config", default="paper", help="name or path of a config/hw/*.yaml (default: paper)")
    p.add_argument("--range-deg", type=float, default=4.0, help="the map reaches this far both ways (default: 4)")
    p.add_argument("--step-deg", type=float, default=0.5, help="between two goals (default: 0.5)")
    p.add_argument("--settle", type=float, default=0.6, help="s before the board counts as at rest (default: 0.6)")
    p.add_argument("--samples", type=int, default=20, help="readings averaged at each rest (default: 20)")
    p.add_argument("--out", type=Path, required=True, help="new YAML file")
    return p


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write. Exit code 2 for bad input or hardware that does not answer, 130 for Ctrl-C."""
    given = parser().parse_args(arguments)
    try:
        if given.out.exists():
            raise InputError(f"{given.out} exists and is left as it is; name another file.")
        content = dict(config.read(config.find("hw", given.config)).content)
        hardware = Hardware(load_hardware(given.config), period=CYCLE)
        hardware.connect()
        hardware.arm()
        try:
            entries = calibrate(hardware, given.range_deg, given.step_deg, given.settle, given.samples)
        finally:
            hardware.close()
        content["compensation"] = {
            name: CompensationSection.of(entry).model_dump(mode="json") for name, entry in entries.items()
        }
        write_new(given.out, yaml.safe_dump(content, sort_keys=False))
    except (InputError, HardwareError, OSError) as error:
        print(f"calibrate_motors: {error}", file=sys.stderr)
        raise SystemExit(2) from error
    except KeyboardInterrupt:
        print("calibrate_motors: interrupted; torque is off, nothing was written.", file=sys.stderr)
        raise SystemExit(130) from None
    for name, entry in entries.items():
        worst = np.degrees(np.abs(entry.errors).max())
        print(f"{name}: positioning error up to {worst:.2f} deg, slack {np.degrees(entry.slack):.2f} deg")
    print(f"written: {given.out}; use it with -p config:={given.out} -p compensate_position_error:=true")


def calibrate(
    hardware: Hardware, range_deg: float, step_deg: float, settle: float, samples: int
) -> dict[str, Compensation]:
    """Lead each motor up and down its range, the others at zero.

    Returns:
        a compensation by motor.

    Raises:
        InputError: no potentiometers, or a range that is not covered by the limits.
        HardwareError: the rig stopped or fell silent.
    """
    if hardware.sensors is None:
        raise InputError("Calibration needs the potentiometers; the configuration has no sensor_port.")
    if not 0 < step_deg <= range_deg or samples < 1 or settle < 0:
        raise InputError(f"Expected 0 < step <= range, got step {step_deg:g} and range {range_deg:g} deg.")
    for name, limit in hardware.settings.limits.items():
        if np.radians(range_deg + BEYOND_DEG) > limit.angle:
            most = np.degrees(limit.angle) - BEYOND_DEG
            raise InputError(f"{name}: --range-deg can be {most:.1f} at most, {BEYOND_DEG:g} within its limit.")
    goals = np.radians(np.linspace(-range_deg, range_deg, 2 * round(range_deg / step_deg) + 1))
    names = [motor.name for motor in hardware.settings.motors]
    # Beyond both ends, so that the outermost goals too are met from below and from above.
    beyond = np.radians(BEYOND_DEG)
    path = [goals[0] - beyond, *goals, goals[-1] + beyond, *goals[::-1]]
    entries = {}
    at: dict[str, float] = {}
    with tqdm(total=len(names) * len(path), desc="calibrate", unit="rest") as bar:
        for axis, name in enumerate(names):
            rests = []
            for goal in path:
                command = {other: float(goal) if other == name else 0.0 for other in names}
                at = lead(hardware, at, command)
                rests.append(rest(hardware, command, axis, settle, samples))
                bar.update()
            half = len(goals)
            entries[name] = measured_map(list(goals), rests[1 : half + 1], rests[half + 2 :][::-1])
            at = lead(hardware, at, dict.fromkeys(names, 0.0))
    return entries


def lead(hardware: Hardware, start: dict[str, float], goals: dict[str, float]) -> dict[str, float]:
    """Move evenly from the last goals, or from where the motors are, to new ones, rad; returns the new ones."""
    if not start:
        measured = _period(hardware, None, time.monotonic() + 2.0)
        start = {name: measured.motors[name].position for name in goals}
    longest = max(abs(goals[name] - start[name]) for name in goals)
    shares = np.linspace(0.0, 1.0, 1 + max(1, round(longest / (LEAD * CYCLE))))[1:]
    for share in shares:
        step = {name: start[name] + float(share) * (goals[name] - start[name]) for name in goals}
        _period(hardware, step, time.monotonic() + 2.0)
    return goals


def rest(hardware: Hardware, goals: dict[str, float], axis: int, settle: float, samples: int) -> float:
    """Hold goals, and return where the board rests on one axis, rad."""
    readings: list[float] = []
    begun = time.monotonic()
    deadline = begun + settle + 20 * samples * CYCLE + 2.0
    while len(readings) < samples:
        measured = _period(hardware, goals, deadline)
        if measured.board is not None and time.monotonic() - begun > settle:
            readings.append((measured.board.x, measured.board.y)[axis])
        elif time.monotonic() > deadline:
            raise HardwareError(f"The rig fell silent: {hardware.trouble or 'no potentiometer readings'}")
    return float(np.mean(readings))


def _period(hardware: Hardware, goals: dict[str, float] | None, deadline: float) -> Measurement:
    """One control period, or as many as it takes to hear the servos. Raises HardwareError after `deadline`."""
    while True:
        due = time.monotonic() + CYCLE
        now = time.monotonic()
        measured = hardware.cycle({name: Goal(angle, now) for name, angle in (goals or {}).items()})
        if hardware.safety.state is State.STOPPED:
            raise HardwareError("; ".join(hardware.safety.reasons))
        time.sleep(max(0.0, due - time.monotonic()))
        if measured is not None:
            return measured
        if time.monotonic() > deadline:
            raise HardwareError(f"The rig fell silent: {hardware.trouble}")


if __name__ == "__main__":
    main()
