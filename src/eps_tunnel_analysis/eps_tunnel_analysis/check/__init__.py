# SPDX-License-Identifier: Apache-2.0
"""Before anything is fitted: the quality of recordings, and what they can identify."""
