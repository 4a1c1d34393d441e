# SPDX-License-Identifier: Apache-2.0
"""Stand-in for the `ros2` command line, which PyPI does not have.

It knows the verbs that a user of this project needs, in the words and with the exit codes of ros2cli in Kilted. Three
differences are meant: `ros2 run` becomes the node instead of its parent, so a signal sent to it reaches the node; there
is no daemon that knows the graph, so every command discovers for itself; `ros2 launch` knows the actions that this
project's launch files use.
"""
