# SPDX-License-Identifier: Apache-2.0
"""Reports: one self-contained HTML page made of sections, one file a section."""
