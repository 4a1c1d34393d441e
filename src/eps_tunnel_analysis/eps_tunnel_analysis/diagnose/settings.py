# SPDX-License-Identifier: Apache-2.0
"""Every number by which a diagnosis decides: its unit, and where it comes from.

"Floors" are mean squares in units of the noise floor: 1 is what a perfect model leaves.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class DiagnosisSettings:
    """Attributes:
    tolerance: share of a signal's motion (root mean square) that does not matter. Chosen: a twentieth of what a
        user would see; healthy rigs of other physics than the model's leave .1 % and less.
    timing: s, by which one trial's motion may be early or late. Derived: the deviation of what happens at any time
        within the period of a firmware's loop of 1 kHz, each trial at a phase of its own.
    rough: share of a stated value, or of its span where 0 is stated, within which a value that is known roughly
        is expected (standard deviation). Chosen: the usual error of servos' data sheets.
    loose: share of a stated value within which those free values are expected whose order of magnitude a data sheet
        gives (standard deviation). Chosen: twice the difference between two windings of the same servo.
    correlated: how many correlated residuals of a motion are worth one independent sample, when they are weighed
        against that expectation. Measured: 10 to 30 on tuning rigs.
    healthy: floors of the worst signal; above this something is missing if an effect explains it, and above two
        widths more if none does. Chosen: between what a healthy rig of other physics than the
        model's leaves (1.0 to 1.4) and what counts as visible (3).
    form: share of the base's misfit that the right effect may leave, because no form of it is exact. Measured on
        tuning rigs: right forms leave up to 4 %, wrong ones 8 % and more.
    material: floors that an effect must explain, at least, to be named. Chosen: a third of what is visible.
    exact: the part of `form` and `share` that is kept for effects that occur in one form only. Chosen: what steps
        and stamps leave of a delay.
    share: of the base's misfit that one more effect must explain. Chosen as `form`, as less may be the first's form.
    curve: share of what a free curve explains that the named effect may miss. Measured as `form`, with room for what a
        curve fits in addition.
    width: of the soft transitions of the above, in logarithms. Chosen: a factor of 1.35 takes odds from 1:10 to 10:1.
    odd: probability that something unknown is missing where trials drift. Chosen.
    coverage: of the stated set.
    block: s, the shortest stretch of time that is left out at once for cross-validation; several correlation lengths of
        the motions such rigs make.
    draws: of the block bootstrap. Derived: leaves 0.5 % of scatter on a probability.
    seeds: of the rigs on which these were chosen; no reported figure uses them.
    """

    tolerance: float = 0.0005
    timing: float = 0.001 / 12**0.5
    rough: float = 0.15
    loose: float = 0.5
    correlated: float = 20.0
    healthy: float = 1.6
    form: float = 0.05
    exact: float = 0.1
    material: float = 0.5
    share: float = 0.03
    curve: float = 0.1
    width: float = 0.13
    odd: float = 0.97
    coverage: float = 0.9
    block: float = 0.75
    draws: int = 1000
    seeds: tuple[int, int] = (9000, 9999)


SETTINGS = DiagnosisSettings()
