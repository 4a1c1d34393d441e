# SPDX-License-Identifier: Apache-2.0
"""MJCF of the shipped rigs.

The labyrinth's files in `config/mjcf/` are made from `config/labyrinth_geometry.yaml`:

    python -m labyrinth_sim.mjcf config/labyrinth_geometry.yaml config/mjcf

geometry.py    the measured figures as values
labyrinth.py   geometry -> MJCF, its floor with round holes out of convex pieces
picture.py     MJCF -> a rendered picture

Names in the model:
    joints      motor_x, motor_y (servos), board_x (outer frame, about x), board_y (inner board, about y), ball (free)
    actuators   motor_x, motor_y: torque, N m
    tendons     belt_x, belt_y: ratio * motor - board, a spring
    sites       board_origin (lower left corner, on the floor), hole_1, hole_2, ...
    sensors     the four hinges by name (rad), with _velocity (rad/s), the two motors with _effort (N m),
                ball (x, y, z of its centre in the board frame, m)

`labyrinth_plain` has the same inertia without walls, holes and ball.
"""
