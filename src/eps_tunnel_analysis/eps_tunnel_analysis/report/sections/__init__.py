# SPDX-License-Identifier: Apache-2.0
"""Sections of a report, one file each. A section is a function from values to a `page.Section`."""
