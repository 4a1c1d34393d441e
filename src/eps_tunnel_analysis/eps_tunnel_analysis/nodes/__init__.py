# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes: they convert, call and publish; the actual work is done outside this folder."""
