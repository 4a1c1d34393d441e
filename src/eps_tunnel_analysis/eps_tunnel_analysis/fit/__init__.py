# SPDX-License-Identifier: Apache-2.0
"""Fitting a model's values to recorded trials: the paper's evolution strategy, CMA-ES, Gauss-Newton."""
