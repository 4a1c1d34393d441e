# SPDX-License-Identifier: Apache-2.0
"""Naming the physical effect that a model lacks: noise floor, candidates, refits, ranking, verdict."""
