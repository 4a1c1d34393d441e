# SPDX-License-Identifier: Apache-2.0
"""How the rig is, in words and numbers, for whoever watches it."""

from collections.abc import Mapping
from dataclasses import dataclass

from labyrinth_hw.hardware import Hardware
from labyrinth_hw.safety import State
from labyrinth_hw.vision import Sight


@dataclass(frozen=True)
class Health:
    """level: "ok", "warn" or "error"; message: one sentence; values: names and texts, units in the names."""

    level: str
    message: str
    values: Mapping[str, str]


def hardware_health(hw: Hardware, counts: Mapping[str, int], sight: Sight | None) -> Health:
    """The state of servos, sensor line and camera.

    Args:
        hw: the rig.
        counts: "cycles", "late", "silent" periods and "refused" commands.
        sight: the newest one; None without a camera.
    """
    level = "ok"
    if not hw.connected or hw.safety.state is State.STOPPED:
        level = "error"
    elif hw.sensors is not None and not hw.sensors_connected:
        level = "warn"
    if hw.connected:
        message = "; ".join(hw.safety.reasons) or hw.safety.state.value
    else:
        message = f"disconnected: {hw.trouble}"
    counters = hw.bus.counters
    values: dict[str, object] = {
        "state": hw.safety.state.name.lower(),
        "packets sent": counters.sent,
        "packets lost": counters.lost,
        "packets damaged": counters.corrupt,
        "retries": counters.retried,
        "failures": counters.failed,
        "reconnects": hw.reconnects,
        "bus time of a cycle [ms]": f"{hw.bus.cycle * 1e3:.2f}",
        "cycles": counts["cycles"],
        "cycles late": counts["late"],
        "cycles without servos": counts["silent"],
        "commands refused": counts["refused"],
        "last trouble": hw.trouble,
    }
    for name, motor in list(hw.slow.items()):
        meanings = hw.safety.meanings.get(name, {})
        values[f"{name} voltage [V]"] = f"{motor.voltage:.1f}"
        values[f"{name} temperature [degC]"] = f"{motor.temperature:.0f}"
        values[f"{name} alarm"] = "; ".join(text for bit, text in meanings.items() if motor.alarm & bit) or "none"
    if hw.sensors is not None:
        values["sensor requests"] = hw.sensors.asked
        values["sensor answers lost"] = hw.sensors.lost
        values["sensor lines damaged"] = hw.sensors.damaged
    if sight is not None:
        values["camera frames"] = sight.frames
        values["camera losses"] = sight.losses
        values["board seen"] = sight.board
        values["ball seen"] = sight.visible
    return Health(level, message, {name: str(value) for name, value in values.items()})
