# SPDX-License-Identifier: Apache-2.0
"""The page to watch: what it shows, who may see it, what it may ask for. Knows nothing of ROS."""
