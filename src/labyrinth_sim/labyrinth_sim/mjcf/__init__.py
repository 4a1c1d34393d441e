# SPDX-License-Identifier: Apache-2.0
"""MJCF of the shipped rigs.

The labyrinth's files in `config/mjcf/` are made from `config/labyrinth_geometry.yaml`:

    python -m labyrinth_sim.mjcf config/labyrinth_geometry.yaml config/mjcf

geometry.py    the measured figures as values
floor.py       a floor with round holes out of boxes
labyrinth.py   geometry -> MJCF
picture.py     MJCF -> a rendered picture

Names in the model: joints `motor_x`, `motor_y` (servos), `board_x` (outer frame, about x), `board_y` (inner board, about
y) and `ball` (free); actuators `motor_x`, `motor_y` (torque, N m); tendons `belt_x`, `belt_y`; sites `board_origin` and
`hole_1` ...; sensors named as the signals (`motor_x`, `motor_x_velocity`, `motor_x_effort`, `board_x`, ...) and `ball`
(x, y, z of the ball's centre in the board frame, m). `labyrinth_plain` has the same inertia without walls, holes and ball.
"""
