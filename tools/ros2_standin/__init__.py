# SPDX-License-Identifier: Apache-2.0
"""Stand-in for the `ros2` command line, which PyPI does not have.

It knows the verbs that a user of this project needs, with the options, words and exit codes of ros2cli in Kilted.
Two differences are meant: `ros2 run` becomes the node instead of its parent, so a signal sent to it reaches the node;
and as there is no daemon that knows the graph, commands look around a little longer before they give up.
"""
