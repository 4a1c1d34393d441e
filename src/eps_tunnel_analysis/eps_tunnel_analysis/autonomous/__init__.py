# SPDX-License-Identifier: Apache-2.0
"""The loop of an experimenter: play, compare, diagnose, play what decides, add, and write it all down."""
