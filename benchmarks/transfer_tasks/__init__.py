# SPDX-License-Identifier: Apache-2.0
"""Tasks in which a controller that was tuned in a model is judged on the emulated rig. A new task is one new file.

task.py          what a task is; its cost in a model and on the rig
board_path.py    the board follows a path: by feed-forward alone, and with feedback from its sensor
ball_control.py  the feedback that rolls the ball to a point that may move
ball_held.py     the ball is brought to a point of an open board and held there
ball_path.py     the ball is rolled along the first stretch of the maze's path
"""

from transfer_tasks import ball_held, ball_path, board_path
from transfer_tasks.task import Task

TASKS: tuple[Task, ...] = (board_path.FEED_FORWARD, board_path.FEEDBACK, ball_held.TASK, ball_path.TASK)
