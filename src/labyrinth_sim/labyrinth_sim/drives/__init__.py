# SPDX-License-Identifier: Apache-2.0
"""One kind of drive per file; each declares DRIVE. Files in this folder are found automatically."""
