# SPDX-License-Identifier: Apache-2.0
"""From "unknown" to a law: the force that a model lacks, what it depends on, a formula, and a file."""
