# SPDX-License-Identifier: Apache-2.0
"""Uses of a model's values: what a change would do, what has changed, and what play would determine them better."""
