# SPDX-License-Identifier: Apache-2.0
"""How far a simulation is from a real rig, where, and which physical effect the model lacks."""
