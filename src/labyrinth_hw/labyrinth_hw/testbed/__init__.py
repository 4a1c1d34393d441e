# SPDX-License-Identifier: Apache-2.0
"""An emulated rig with physics of its own.

    rig = load_testbed("healthy", effects=["backlash.x=strong"])
    run = run_offline(rig, time, commands, trials=5, seed=1)
    write_bag(folder, run, "excite_12s", digest)

`LiveTestbed` puts it behind serial ports instead, in real time: `ros2 run labyrinth_hw testbed`.
"""

from labyrinth_hw.testbed.bags import read_commands, write_bag
from labyrinth_hw.testbed.hidden import (
    EFFECTS,
    SENSOR_SIGNALS,
    STRENGTHS,
    Hidden,
    TestbedConfig,
    draw,
    hide,
    load_testbed,
)
from labyrinth_hw.testbed.offline import Run, run_many, run_offline
from labyrinth_hw.testbed.quantities import QUANTITIES
from labyrinth_hw.testbed.scene import Layout, load_layout

__all__ = [
    "EFFECTS",
    "QUANTITIES",
    "SENSOR_SIGNALS",
    "STRENGTHS",
    "Hidden",
    "Layout",
    "Run",
    "TestbedConfig",
    "draw",
    "hide",
    "load_layout",
    "load_testbed",
    "read_commands",
    "run_many",
    "run_offline",
    "write_bag",
]
