# SPDX-License-Identifier: Apache-2.0
"""Values of a model fitted to recordings, with intervals and the range over which they were validated."""
