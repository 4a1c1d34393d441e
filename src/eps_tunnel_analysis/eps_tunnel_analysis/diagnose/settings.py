# SPDX-License-Identifier: Apache-2.0
"""Every number on which a verdict depends: its unit, and where it comes from.

"Floors" are mean squares in units of the noise floor: 1 is what a perfect model leaves. Numbers in the other modules
say how much is searched: larger ones cost time and do not change what counts as right.
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
    farthest: of these deviations, how many a value that is known roughly may be off. Derived: 95 % of a Gaussian.
    strained: minus twice the log-likelihood of the base values beside what is stated, above which a base counts as
        deviating. Derived: one value that is off by one deviation.
    unfelt: floors; a value that is known roughly and moves the recordings by less stays as stated. Chosen: a hundredth
        of what is visible.
    tails: degrees of freedom of Student's t distribution of stated values about the true ones. Chosen: 4, after Lange
        et al. (1989); in the tails lie values that are stated wrongly, such as the inertia of another rotor.
    correlated: how many correlated residuals of a motion are worth one independent sample, when they are weighed
        against that expectation. Measured: 10 to 30 on tuning rigs.
    healthy: floors of the worst signal; above this something is missing if an effect explains it, and above two
        widths more if none does. Chosen: between what a healthy rig of other physics than the
        model's leaves (1.0 to 1.4) and what counts as visible (3).
    unrepeated: times `healthy`, and times what a form may leave, where no trial is repeated and the rig's own spread is
        unknown. Chosen: a rig whose trials differ as much as the sensors' noise.
    close: times what may be left, `healthy` or more; below this no further effect is tried. Chosen: a quarter less,
        as a further effect may have to be ruled out.
    form: share of the base's misfit that the right effect may leave, because no form of it is exact. Measured on
        tuning rigs: right forms leave up to 4 %, wrong ones 8 % and more.
    material: floors that an effect must explain, at least, to be named. Chosen: a third of what is visible.
    worthwhile: share of the misfit beyond noise that an effect must explain before another one is tried on top of it.
        Chosen: what explains less is no start.
    exact: the part of `form` and `share` that is kept for effects that occur in one form only. Chosen: what steps
        and stamps leave of a delay.
    share: of the base's misfit that one more effect must explain, unless it takes what is left to the noise. Chosen as
        `form`, as less may be the first's form.
    curve: share of what a free curve explains that the named effect may miss. Measured as `form`, with room for what a
        curve fits in addition.
    width: of the soft transitions of the above, in logarithms. Chosen: a factor of 1.35 takes odds from 1:10 to 10:1.
    kept: share of a stretch's information on the values that is kept when it is left out, as if it had been played
        once more. Otherwise a motion that occurs once in a recording would be predicted by an extrapolation to first
        order. Chosen: half.
    odd: probability that something unknown is missing where trials drift. Chosen.
    overlooked: share of "something unknown" that is for effects of the library which no descent found. Measured: 6 of
        22 rigs that were called unknown hid only effects of the library, most of them two.
    imitated: share of the probability of a set of effects that is for something else which behaves like it. Measured:
        of 131 sets that were the likeliest at over 90 % on drawn rigs, 34 were something else, of one effect as of two.
    drift_trials: trials, for a drift. Derived: every third set of three goes one way by chance.
    drift_slope: slope over its standard error, of a drift, both over the trials and over stretches of them. Derived:
        either happens by chance in 3 % of sets of four trials, not both.
    drift_noise: times what the sensors' noise alone would let the trials' means differ by, of a drift. Chosen: healthy
        rigs whose starts differ stay below.
    timing_share: of the differences between trials that the squared speed explains, of uneven timing. Chosen.
    timing_follows: correlation with the squared speed, of uneven timing. Chosen.
    ticks_surely: deviations by which ticks of model and rig must agree. Derived: 95 % of a Gaussian.
    ticks_agree: share of what the model's ticks do that the rig's may do as well, at most. Chosen, as noise shakes a
        rig's ticks.
    doubted: of the misfit that the best effect leaves; a stated value whose refit leaves more is not doubted. Chosen.
    promising: share of the misfit that a stated value must explain to first order, to be refitted. Chosen.
    coverage: of the stated set, among what has a name: whatever behaves like an effect is in the set with it.
    clear: probability from which one effect on one axis is stated by itself, as `coverage`. Chosen as that.
    worth_stating: share of an axis's misfit that an effect must explain to be stated beside "unknown". Chosen.
    block: s, the shortest stretch of time that is left out at once for cross-validation; several correlation lengths of
        the motions such rigs make.
    draws: of the block bootstrap. Derived: leaves 0.5 % of scatter on a probability.
    law_level: share of healthy rigs that may name a variable. Chosen: what the benchmark's bar allows.
    law_falls: of the base's floors on left-out stretches; a law that leaves more is not proposed. Chosen.
    law_as_good: times a free curve's floors on left-out stretches; a formula that leaves no more is preferred. Chosen:
        a formula can be understood.
    law_no_worse: times the least that a formula leaves; of those within it the shortest is kept. Chosen.
    law_complete: floors on left-out stretches; a formula that leaves no more needs no curve beside it. Chosen as
        `healthy`, with room for what was not fitted.
    law_confirmed: share of what a model leaves of another command beyond noise that a law must take away to count as
        confirmed. Chosen: half, as the benchmark asks.
    seeds: of the rigs on which these were chosen; no reported figure uses them.
    """

    tolerance: float = 0.0005
    timing: float = 0.001 / 12**0.5
    rough: float = 0.15
    loose: float = 0.5
    farthest: float = 2.0
    strained: float = 1.0
    unfelt: float = 0.02
    tails: float = 4.0
    correlated: float = 20.0
    healthy: float = 1.6
    unrepeated: float = 2.0
    close: float = 0.75
    form: float = 0.05
    material: float = 0.5
    worthwhile: float = 0.2
    exact: float = 0.1
    share: float = 0.03
    curve: float = 0.1
    width: float = 0.13
    kept: float = 0.5
    odd: float = 0.97
    overlooked: float = 0.25
    imitated: float = 0.25
    drift_trials: int = 4
    drift_slope: float = 6.0
    drift_noise: float = 10.0
    timing_share: float = 0.4
    timing_follows: float = 0.6
    ticks_surely: float = 2.0
    ticks_agree: float = 0.9
    doubted: float = 0.5
    promising: float = 0.1
    coverage: float = 0.9
    clear: float = 0.9
    worth_stating: float = 0.2
    block: float = 0.75
    draws: int = 1000
    law_level: float = 0.05
    law_falls: float = 0.7
    law_as_good: float = 1.2
    law_no_worse: float = 1.02
    law_complete: float = 2.0
    law_confirmed: float = 0.5
    seeds: tuple[int, int] = (9000, 9999)


SETTINGS = DiagnosisSettings()
