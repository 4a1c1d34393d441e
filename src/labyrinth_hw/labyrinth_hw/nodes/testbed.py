# SPDX-License-Identifier: Apache-2.0
"""`ros2 run labyrinth_hw testbed`: an emulated rig behind pseudo-serial ports. Needs no ROS."""

from labyrinth_hw.testbed.command_line import main

__all__ = ["main"]

if __name__ == "__main__":
    main()
