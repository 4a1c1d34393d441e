# SPDX-License-Identifier: Apache-2.0
"""Values of a model that show only where they are further off than expected: a torque that only some moves need."""

import numpy as np
import pytest
from fit_cases import search_on_x

from eps_tunnel_analysis.diagnose.base_values import woken
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.search import Search

TORQUE, NEEDED = "drive.x.torque", 2.2  # N m, less than which limits the motion


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch, torque: float) -> Search:
    """Of an axis whose motor gives a torque, in N m; beside noise only what that limits shows."""
    search = search_on_x()
    column, size = search.library.names.index(TORQUE), len(search.used)
    noise, limited = 0.5 * np.random.default_rng(0).standard_normal(size), np.arange(size) % 7 == 0

    def residuals(values: np.ndarray, *_: object) -> np.ndarray:
        search.evaluations += len(values)
        missing = np.maximum(NEEDED - values[:, column], 0.0) - max(NEEDED - torque, 0.0)
        return noise + 50.0 * missing[:, None] * limited

    monkeypatch.setattr(search, "residuals", residuals)
    return search


@pytest.mark.parametrize("torque", [2.8, 2.0])
def test_a_torque_that_limits_only_far_from_what_is_stated_is_fitted_there(search: Search, torque: float) -> None:
    column = search.library.names.index(TORQUE)
    stated = search.start[column]
    (base,) = search.judged([((), search.start)], 0)
    search.feel(base)
    assert search.idle[column], "a deviation off it does not show"
    found = woken(search, base)
    assert search.idle[column] == (torque == stated)
    assert found.values[column] == pytest.approx(torque, rel=0.02)
    assert (found is base) == (torque == stated)
    assert worst_floors(found.residuals, search.signal) < 0.5
