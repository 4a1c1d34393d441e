# SPDX-License-Identifier: Apache-2.0
"""The few numbers by which a misfit becomes a probability, and the cases they were calibrated on."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Calibration:
    """Attributes:
    clean: share of the gate below which an axis needs no candidates.
    gate: mean square, in units of the noise floor, that a complete model leaves at most.
    left_over: share of the base's mean square that the right effect may leave too, for no model of it is exact.
    second: of what may be left, the share that one more effect must not leave to be named too.
    odd: probability that something unknown is missing where trials drift or are timed unevenly.
    gain: relative gain (logarithm) that candidates reach where nothing is missing.
    gain_weight: how a gain beyond it counts against completeness, beside the level itself.
    none_width, unknown_width: of the logistic transitions, in logarithms of the mean square.
    temperature: by which differences of log-likelihood are divided, for models err together.
    value: times half the logarithm of the independent samples that each fitted value pays.
    coverage: of the stated set.
    seeds: of the emulated rigs on which these were chosen; no reported figure uses them.
    """

    gate: float = 1.1
    left_over: float = 0.03
    second: float = 0.4
    odd: float = 0.97
    clean: float = 0.8
    gain: float = 0.06
    gain_weight: float = 6.0
    none_width: float = 0.08
    unknown_width: float = 0.15
    temperature: float = 2.0
    value: float = 2.0
    coverage: float = 0.9
    seeds: tuple[int, int] = (9000, 9999)


CALIBRATION = Calibration()
