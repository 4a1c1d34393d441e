# SPDX-License-Identifier: Apache-2.0
"""One physical effect per file; each declares EFFECT. Files in this folder are found automatically."""
