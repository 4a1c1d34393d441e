# SPDX-License-Identifier: Apache-2.0
"""The studies of transfer and of values run, write what they promise, and judge on what no fit has seen."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import spearmanr

from labyrinth_sim.model import load_model

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import testbed_cases
import transfer
import values
from transfer_figures import correlation, ranked
from transfer_tasks import TASKS
from transfer_tasks.task import in_model, on_rig, play

FIGURES = (
    "rmse",
    "error",
    "floors",
    "remaining",
    "k half",
    "probes' track",
    *(f"alikeness k={k}" for k in range(1, 6)),
)


def written(monkeypatch: pytest.MonkeyPatch, program: Any, folder: Path, *more: str) -> dict[str, Any]:
    """What a quick run writes."""
    file = folder / "out.json"
    monkeypatch.setattr(sys, "argv", [program.__file__, "--quick", "--json", str(file), *more])
    program.main()
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    assert content["quick"] is True
    return content


@pytest.mark.study
def test_transfer_ranks_models_by_a_recording_that_was_not_fitted(monkeypatch, tmp_path: Path) -> None:
    content = written(monkeypatch, transfer, tmp_path, "--svg", str(tmp_path / "out.svg"))
    for name in FIGURES:
        value, low, high = content["spearman"][name]
        assert -1.0 <= low <= value <= high <= 1.0 or np.isnan(value), name
    assert content["above_rmse"]["rmse"] == [0.0, 0.0, 0.0]
    assert content["rmse_spearman"] == content["spearman"]["rmse"]
    assert content["rmse_fitted_spearman"] == content["spearman"]["rmse fitted"]
    assert content["floors_spearman"] == content["spearman"]["floors"]
    assert content["floors_fitted_spearman"] == content["spearman"]["floors fitted"]
    assert content["spearman"][content["best"]][0] == max(v for v, _, _ in content["spearman"].values() if v == v)
    for more in ("spearman_gap", "spearman_distance", "spearman_together", "above_rmse"):
        assert set(content[more]) == set(content["spearman"])
    shown = {m["model"]: m["figures"] for m in content["models"]}
    assert len(shown) == 6
    assert set(content["tasks"]) == {"board, feed-forward", "board, feedback", "ball, held", "ball, path"}
    for name, task in content["tasks"].items():
        assert set(task["spearman"]) == set(content["spearman"])
        for model in content["models"]:
            assert model["tasks"][name]["in_model"] > 0.0 and model["tasks"][name]["on_rig"] > 0.0
    assert all(f["rmse"] != f["rmse fitted"] and f["floors"] != f["floors fitted"] for f in shown.values())
    right = shown["calibrated + backlash.x + coulomb_friction.x + gravity_load.x"]
    assert right["rmse"] < 0.2 * shown["calibrated"]["rmse"], "what is right holds on the other command, too"
    held = {m["model"]: m["tasks"]["ball, held"]["on_rig"] for m in content["models"]}
    assert held["calibrated + backlash.x + coulomb_friction.x + gravity_load.x"] < 0.3 * held["standard"]
    assert (tmp_path / "out.svg").is_file()
    # A run that goes on from here has every task behind it.
    setting = {name: content[name] for name in ("quick", "seed", "probes")}
    assert {n: own for n, (_, own) in transfer.finished(content, setting).items()} == {
        n: [m["tasks"][n] for m in content["models"]] for n in content["tasks"]
    }
    del content["models"][2]["tasks"]["ball, held"]["on_rig"]
    assert set(content["tasks"]) - set(transfer.finished(content, setting)) == {"ball, held"}
    with pytest.raises(ValueError, match="seed"):
        transfer.finished(content, setting | {"seed": 1})


def test_the_judged_command_stays_within_what_was_fitted_and_is_another() -> None:
    (_, fitted), (_, judged) = (c.sample(100.0) for c in (transfer.fitted_command(), transfer.judged_command()))
    assert judged.shape != fitted.shape or not np.allclose(judged, fitted)
    assert fitted[:, 0].min() - 0.006 <= judged[:, 0].min() and judged[:, 0].max() <= fitted[:, 0].max()


@pytest.mark.study
def test_a_calibrated_model_prices_controllers_as_the_rig_does() -> None:
    """Without anything hidden the rig and the model share the costs of every task, though no line of physics."""
    model = load_model("labyrinth_mx64").with_values({"drive.x.delay": 0.02, "drive.y.delay": 0.02})
    for task in TASKS:
        values = task.of_shares(np.stack([task.begin, 0.8 * task.begin + 0.1]))
        expected = on_rig(task, play(task, testbed_cases.rig(()), values, 2, 1))
        np.testing.assert_allclose(in_model(task, model, values, 1), expected, rtol=0.35, err_msg=task.name)


def test_spearman_is_that_of_scipy_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.integers(5, size=(2, 4, 20)).astype(float)
    np.testing.assert_allclose(ranked(x, y), [spearmanr(a, b).statistic for a, b in zip(x, y, strict=True)])
    value, low, high = correlation(list(x), list(x + 0.3 * y))
    assert low < value < high <= 1.0
    assert np.isnan(ranked(np.ones((1, 4)), np.arange(4.0)[None])[0])


@pytest.mark.study
def test_values_counts_intervals_repeats_and_designed_plays(monkeypatch, tmp_path: Path) -> None:
    content = written(monkeypatch, values, tmp_path, "--workers", "1")
    for key in ("interval_coverage", "interval_coverage_missing", "repeat_agreement"):
        low, high = content[f"{key}_interval"]
        assert 0.0 <= low <= content[key] <= high <= 1.0
        assert content[f"{key}_n"] == content["figures"][f"{key}_n"] > 0
    assert content["width_ratio_designed"] > 0.0 and content["width_ratio_designed_n"] == 1
    assert [len(content["cases"][of]) for of in ("complete", "missing", "repeated", "designed")] == [2, 2, 1, 1]
