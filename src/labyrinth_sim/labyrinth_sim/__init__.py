# SPDX-License-Identifier: Apache-2.0
"""Rigs, models, effects and their simulation with MuJoCo; independent of ROS outside `nodes/`."""
