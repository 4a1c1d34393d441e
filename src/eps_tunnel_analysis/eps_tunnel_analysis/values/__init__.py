# SPDX-License-Identifier: Apache-2.0
"""What a model's values are good for: what a change would do, what has changed, and what would tell them better."""
