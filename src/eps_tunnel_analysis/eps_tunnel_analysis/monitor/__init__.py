# SPDX-License-Identifier: Apache-2.0
"""The web page: what it shows, who may see it, what it may request. Independent of ROS."""
