# SPDX-License-Identifier: Apache-2.0
"""The ball is brought to the middle of an open board and held there."""

import numpy as np

from transfer_tasks.ball_control import ball_task

GOAL = np.array([0.138, 0.1155])  # m

TASK = ball_task(
    name="ball, held",
    goal=lambda t: (GOAL, np.zeros(2)),
    points=lambda t: GOAL,
    arrived=1.5,
    generations=25,
    starts=((0.118, 0.165), (0.148, 0.066)),
)
