# SPDX-License-Identifier: Apache-2.0
"""Reports: one self-contained HTML page made of sections.

A section is a function that turns values into a `page.Section` of text, figures, tables and charts. A report is a list
of such functions, as `reports.SECTIONS`; `page.render` makes the page.
"""
