# SPDX-License-Identifier: Apache-2.0
"""From a robot's own model and recordings to a rig and a model file, with a reason for every value."""
