# SPDX-License-Identifier: Apache-2.0
"""Before anything is fitted: what recordings are like, and what they can tell."""
