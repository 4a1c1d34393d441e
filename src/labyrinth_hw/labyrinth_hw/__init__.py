# SPDX-License-Identifier: Apache-2.0
"""Servo bus, camera and ball tracker of the labyrinth rig, and an emulated testbed that answers like one."""
