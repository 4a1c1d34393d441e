# SPDX-License-Identifier: Apache-2.0
"""The loop: play, compare, diagnose, play what decides, add, and again; on recordings or on any rig that plays."""
