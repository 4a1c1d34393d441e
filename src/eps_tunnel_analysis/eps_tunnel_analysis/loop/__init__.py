# SPDX-License-Identifier: Apache-2.0
"""The loop: play, compare, diagnose, play the deciding experiment, add effects, and repeat; on recordings or on a
running rig."""
