# SPDX-License-Identifier: Apache-2.0
"""A model into files for other programs: an MJCF, and a Python module for what acts between MuJoCo's steps."""
