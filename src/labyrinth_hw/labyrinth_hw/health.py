# SPDX-License-Identifier: Apache-2.0
"""How the rig is, in words and numbers, for whoever watches it."""

import time
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


BLIND_AFTER = 1.0  # s without a picture


def hardware_health(hw: Hardware, counts: Mapping[str, int], camera: bool, sight: Sight | None) -> Health:
    """The state of servos, sensor line and camera.

    Args:
        hw: the rig.
        counts: "cycles", "late", "silent" and "unseen" periods, "refused" commands, "clock steps".
        camera: whether there is to be one.
        sight: the newest one; None before the first picture.
    """
    blind = camera and (sight is None or time.monotonic() - sight.stamp > BLIND_AFTER)
    level = "ok"
    if not hw.connected or hw.safety.state is State.STOPPED:
        level = "error"
    elif blind or (hw.sensors is not None and not hw.sensors_connected):
        level = "warn"
    if hw.connected:
        message = "; ".join(hw.safety.reasons) or hw.safety.state.value
    else:
        message = f"disconnected: {hw.trouble}"
    if hw.sensors is not None and not hw.sensors_connected:
        message += "; no potentiometers, so no joint states: the sensor line is gone"
    if blind:
        message += "; no pictures from the camera"
    elif sight is not None and not sight.board:
        message += "; the camera does not see the board"
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
        "cycles without potentiometers": counts["unseen"],
        "commands refused": counts["refused"],
        "clock steps": counts["clock steps"],
        "watchdog armed again": hw.watchdog,
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
    if camera:
        values["camera"] = "no pictures" if blind else "delivers pictures"
    if sight is not None:
        values["camera frames"] = sight.frames
        values["camera losses"] = sight.losses
        values["board seen"] = sight.board and not blind
        values["ball seen"] = sight.visible and not blind
    return Health(level, message, {name: str(value) for name, value in values.items()})
