# SPDX-License-Identifier: Apache-2.0
"""docs/reference.md, made from the code: `make setup`, `source env.bash`, then `python tools/reference_page`."""
