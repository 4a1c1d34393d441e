# SPDX-License-Identifier: Apache-2.0
"""Lets the tests import the modules of cases beside them, and takes as long as a busy machine needs."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")
