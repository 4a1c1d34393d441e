# SPDX-License-Identifier: Apache-2.0
"""How far a simulation is from a real rig, where, which physical effect the model lacks, and the proof that adding it helps."""
