# SPDX-License-Identifier: Apache-2.0
"""One physical effect a file; each declares EFFECT. A file put here is found without being named anywhere."""
