# SPDX-License-Identifier: Apache-2.0
"""The studies of transfer and of values run, write what they promise, and judge on what no fit has seen."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import transfer
import values

FIGURES = ("rmse", "error", "floors", "remaining", *(f"alikeness k={k}" for k in range(1, 6)))


def written(monkeypatch: pytest.MonkeyPatch, program: Any, folder: Path, *more: str) -> dict[str, Any]:
    """What a quick run writes."""
    file = folder / "out.json"
    monkeypatch.setattr(sys, "argv", [program.__file__, "--quick", "--json", str(file), *more])
    program.main()
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    assert content["quick"] is True
    return content


def test_transfer_ranks_models_by_a_recording_that_was_not_fitted(monkeypatch, tmp_path: Path) -> None:
    content = written(monkeypatch, transfer, tmp_path, "--svg", str(tmp_path / "out.svg"))
    for name in FIGURES:
        value, low, high = content["spearman"][name]
        assert -1.0 <= low <= value <= high <= 1.0 or np.isnan(value), name
    assert content["rmse_spearman"] == content["spearman"]["rmse"]
    assert content["rmse_fitted_spearman"] == content["spearman"]["rmse fitted"]
    assert content["floors_spearman"] == content["spearman"]["floors"]
    assert content["floors_fitted_spearman"] == content["spearman"]["floors fitted"]
    assert set(content["spearman_gap"]) == set(content["spearman"])
    shown = {m["model"]: m["figures"] for m in content["models"]}
    assert len(shown) == 6
    assert all(f["rmse"] != f["rmse fitted"] and f["floors"] != f["floors fitted"] for f in shown.values())
    right = shown["calibrated + backlash.x + coulomb_friction.x + gravity_load.x"]
    assert right["rmse"] < 0.2 * shown["calibrated"]["rmse"], "what is right holds on the other command, too"
    assert (tmp_path / "out.svg").is_file()


def test_the_judged_command_stays_within_what_was_fitted_and_is_another() -> None:
    (_, fitted), (_, judged) = (c.sample(100.0) for c in (transfer.fitted_command(), transfer.judged_command()))
    assert judged.shape != fitted.shape or not np.allclose(judged, fitted)
    assert fitted[:, 0].min() - 0.006 <= judged[:, 0].min() and judged[:, 0].max() <= fitted[:, 0].max()


def test_values_counts_intervals_repeats_and_designed_plays(monkeypatch, tmp_path: Path) -> None:
    content = written(monkeypatch, values, tmp_path, "--workers", "1")
    for key in ("interval_coverage", "interval_coverage_missing", "repeat_agreement"):
        low, high = content[f"{key}_interval"]
        assert 0.0 <= low <= content[key] <= high <= 1.0
        assert content[f"{key}_n"] == content["figures"][f"{key}_n"] > 0
    assert content["width_ratio_designed"] > 0.0 and content["width_ratio_designed_n"] == 1
    assert [len(content["cases"][of]) for of in ("complete", "missing", "repeated", "designed")] == [2, 2, 1, 1]
