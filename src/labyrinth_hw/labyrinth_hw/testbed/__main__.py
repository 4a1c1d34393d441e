# SPDX-License-Identifier: Apache-2.0
from labyrinth_hw.testbed.command_line import main

main()
