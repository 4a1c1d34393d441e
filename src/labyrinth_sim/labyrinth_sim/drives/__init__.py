# SPDX-License-Identifier: Apache-2.0
"""One kind of drive a file; each declares DRIVE. A file put here is found without being named anywhere."""
