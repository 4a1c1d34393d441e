# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a drawn rig: each effect in the forms that nature gives it, at any strength.

An effect that the model's library knows has the library's name; `OUTSIDE` names the others. A form turns a healthy
reality into one that has the effect: a new one is a function and an entry.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drawn_rigs.physics import Array
from drawn_rigs.reality import Reality
from drawn_rigs.rigs import LONGEST_DELAY, Rig

Apply = Callable[[Rig, Reality, int, str, float, Array], Reality]
"""(rig, its reality, number of the axis, place, strength with sign, five numbers drawn from 0 to 1) -> reality."""


@dataclass(frozen=True)
class Form:
    """One way in which an effect occurs.

    Attributes:
        effect: its name in the library, or here.
        name: of the form.
        low, high: strengths between which it is calibrated, in the form's own unit, always positive.
        apply: puts it into a rig.
        signed: whether the sign is drawn.
        fits: whether a rig can have it, on an axis.
        sensor: whether its place is a signal instead of an axis.
        outside: whether no effect of the library is of this kind.
        before: the reality against which it is visible; None for the healthy one.
        also: other names in the library that are right, because it is literally their law.
        everywhere: whether it is the same at whatever axis it is stated.
    """

    effect: str
    name: str
    low: float
    high: float
    apply: Apply
    signed: bool = False
    fits: Callable[[Rig, int], bool] = lambda rig, axis: True
    sensor: bool = False
    outside: bool = False
    before: Callable[[Reality, int], Reality] | None = None
    also: tuple[str, ...] = ()
    everywhere: bool = False


def _most(rig: Rig, axis: int) -> float:
    """N m that the motor gives."""
    return rig.reality.physics.of(axis, "torque")


def _speed(rig: Rig, axis: int) -> float:
    """rad/s, a quick motion of this axis."""
    return 3.0 * rig.reach[axis]


def _inertia(rig: Rig, axis: int) -> float:
    physics = rig.reality.physics
    carried = physics.of(1, "mass") * physics.rig.get("link", 0.0) ** 2 if len(physics.axes) > 1 and axis == 0 else 0.0
    return physics.of(axis, "inertia") + physics.of(axis, "armature") + carried


def _belt(rig: Rig, axis: int) -> bool:
    return rig.reality.physics.rig.get("yields", 0.0) > 0


def _rigid(rig: Rig, axis: int) -> bool:
    return not _belt(rig, axis)


def _two(rig: Rig, axis: int) -> bool:
    return len(rig.axes) > 1


def _seen_twice(rig: Rig, axis: int) -> bool:
    """Two sensors on one axis: an error of one of them can be separated from the axis's motion."""
    return len(rig.positions(axis)) > 1


def _effort(rig: Rig, axis: int) -> bool:
    """A dead band and dry friction under a stiff drive differ in effort alone."""
    return f"{rig.joints[axis]}_effort" in rig.reality.sensors


def _unknown_friction(rig: Rig, axis: int) -> bool:
    return not rig.friction


def _dry(rig: Rig, axis: int) -> bool:
    return _unknown_friction(rig, axis) and _effort(rig, axis)


def _coulomb(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, coulomb=s * _most(rig, a))


def _tanh(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    level = s * _most(rig, a)
    slow = _speed(rig, a) * (0.002 + 0.02 * u[0])
    resolved = 2e-4 * level / (rig.reality.physics.of(a, "armature") if _belt(rig, a) else _inertia(rig, a))
    return r.with_axis(a, coulomb=level, friction_form=1, smooth_speed=max(slow, resolved))


def _lugre(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    level = s * _most(rig, a)
    bristle = level / (rig.reach[a] * 0.01 * (0.1 + u[0]))
    damping = 0.3 * float(np.sqrt(bristle * _inertia(rig, a)))
    return r.with_axis(a, coulomb=level, friction_form=2, bristle=bristle, bristle_damping=damping)


def _dahl(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    level = s * _most(rig, a)
    return r.with_axis(a, coulomb=level, friction_form=3, bristle=level / (rig.reach[a] * 0.01 * (0.1 + u[0])))


def _long_bristles(form: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        level = s * _most(rig, a)
        bristle = level / (rig.reach[a] * (0.05 + 0.25 * u[0]))
        damping = 0.1 * float(np.sqrt(bristle * _inertia(rig, a))) if form == 2 else 0.0
        return r.with_axis(a, coulomb=level, friction_form=form, bristle=bristle, bristle_damping=damping)

    return apply


def _pull(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, pull=s * _most(rig, a))


def _viscous_one_way(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    level = abs(s) * _most(rig, a) / _speed(rig, a)
    return r.with_axis(a, **({"upward_viscous": level} if s > 0 else {"downward_viscous": level}))


def _viscous(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, viscous=s * _most(rig, a) / _speed(rig, a))


def _grease(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, viscous=s * _most(rig, a) / _speed(rig, a), thinning=_speed(rig, a) * (4 + 6 * u[0]))


def _stribeck(form: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        slow = _speed(rig, a) * float(10 ** (-1.6 + u[0]))
        return r.with_axis(a, stribeck=s * _most(rig, a), stribeck_speed=slow, stribeck_form=form)

    return apply


def _load(form: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        return r.with_axis(a, load_driving=s, load_driven=s, load_form=form)

    return apply


def _load_by_power(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    other = s * (0.1 + 0.3 * u[0])
    pair = (s, other) if u[1] < 0.5 else (other, s)
    return r.with_axis(a, load_driving=pair[0], load_driven=pair[1])


def _one_way(form: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        level = abs(s) * _most(rig, a)
        slow = max(_speed(rig, a) * 0.01, 2e-4 * level / rig.reality.physics.of(a, "armature"))
        way = {"upward": level} if s > 0 else {"downward": level}
        return r.with_axis(a, friction_form=form, smooth_speed=slow, **way)

    return apply


def _dead_band(form: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        return r.with_axis(a, dead_band=s * rig.reach[a], dead_band_form=form)

    return apply


def _rate(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, rate=_speed(rig, a) / s)


def _profile(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    """The rate is beyond what the setpoint reaches in a step from end to end: what shows is the acceleration."""
    acceleration = _speed(rig, a) / s
    reached = float(np.sqrt(acceleration * 2.0 * rig.reach[a]))
    rate = max(3.0 * _speed(rig, a), reached) * (1.1 + u[0])
    return r.with_axis(a, rate=rate, rate_acceleration=acceleration)


def _cut_back(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, cut_share=(0.3 + 0.5 * u[0]) / s, cut_bound=1.0 / s, cut_time=0.05 * u[1])


def _saturation(soft: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        return r.with_axis(a, torque_share=1.0 / s, soft_limit=soft)

    return apply


def _sag(slow: bool) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        return r.with_rig(sag=s, sag_time=0.001 + 0.003 * u[0] if slow else 0.0)

    return apply


def _delay(jitter: float) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        late = LONGEST_DELAY + s
        return r.with_path(a, delay=late * (1 - jitter / 2), delay_jitter=late * jitter)

    return apply


def _latest(r: Reality, a: int) -> Reality:
    return r.with_path(a, delay=LONGEST_DELAY)


def _command_tick(truncates: bool) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        register = r.paths[a].tick  # whose bits are fewer than stated
        tick = max(round(s * rig.reach[a] / register), 1) * register if register else s * rig.reach[a]
        return r.with_path(a, tick=tick, truncates=truncates)

    return apply


def _gain(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_path(a, gain=1.0 + s)


def _by_target(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    period = rig.reach[a] * (0.4 + 1.6 * u[0])
    return r.with_path(a, error=s * rig.reach[a], error_period=period, error_phase=u[1])


def _by_angle(form: int) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        period = rig.reach[a] * (0.4 + 1.6 * u[0])
        error = {"feedback_error": s * rig.reach[a], "feedback_period": period, "feedback_phase": u[1]}
        return r.with_axis(a, **error, feedback_form=form)

    return apply


def _unbalanced(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array, arm: float = 0.05) -> Reality:
    moment = s * 0.3 * _most(rig, a) / 9.81
    physics = r.physics
    inertia = physics.of(a, "inertia") + abs(moment) * arm
    mass = physics.of(a, "mass") + abs(moment) / arm
    return r.with_axis(a, sideways=moment, inertia=inertia, mass=mass)


def _far_mass(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return _unbalanced(rig, r, a, place, s, u, 0.03 + 0.06 * u[0])


def _spring(hard: bool) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        harder = (0.2 + 0.4 * u[0]) / rig.reach[a] if hard else 0.0
        return r.with_axis(a, spring=s * 0.5 * _most(rig, a) / rig.reach[a], spring_hardening=harder)

    return apply


def _slack(contact: bool) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        width = s * rig.reach[a]
        if _belt(rig, a):
            hard = {"contact": 5.0 + 20.0 * u[1], "damping": 0.0} if contact else {}
            return r.with_axis(a, gap=width, hold=0.002 + 0.006 * u[0], **hard)
        for signal in rig.positions(a):
            r = r.with_sensor(signal, play=width, play_mass=0.01 + 0.02 * u[0] if contact else 0.0)
        return r

    return apply


def _soft_belt(hard: bool) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        physics = r.physics
        softer = 1.0 + s
        keep = 0.1 + 0.5 * u[0]
        stretch = physics.of(a, "stiffness") / softer / (0.1 * _most(rig, a))
        return r.with_axis(
            a, stiffness=physics.of(a, "stiffness") / softer, hardening=0.5 * stretch if hard else 0.0,
            damping=physics.of(a, "damping") * (keep + (1 - keep) / softer),
        )  # fmt: skip

    return apply


def _crossed(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, cross=s) if _belt(rig, a) else r.with_path(a, cross=s)


def _sensor(**of: float) -> Apply:
    """A sensor's quantity as a multiple of the strength; of `delay` and `lag` in s, else in shares of the reach."""

    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        values: dict[str, float] = {}
        for name, share in of.items():
            if name == "gain":
                values[name] = 1.0 + share * s
            elif name in ("averages", "truncates"):
                values[name] = bool(share)
            else:
                values[name] = share * s * (1.0 if name in ("delay", "delay_jitter", "lag") else rig.reach[a])
        return r.with_sensor(place, **values)

    return apply


def _coarser(truncates: bool) -> Apply:
    def apply(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
        tick = r.sensors[place].tick * (1.0 + s)
        return r.with_sensor(place, tick=tick, truncates=truncates)

    return apply


def _cogging(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, cogging=s * _most(rig, a), cogging_period=rig.reach[a] * (0.15 + 0.5 * u[0]))


def _eccentric(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    size, period = s * rig.reach[a], rig.reach[a] * (0.3 + u[0])
    if _belt(rig, a):
        return r.with_axis(a, uneven=size, uneven_period=period)
    return r.with_sensor(rig.positions(a)[-1], ripple=size, ripple_period=period)


def _loose_mount(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    friction, play = _most(rig, a) * (0.002 + 0.008 * u[0]), s * rig.reach[a]
    return r.with_axis(a, mount_play=play, mount_friction=friction, mount_damping=_most(rig, a) / _speed(rig, a))


def _warming(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    r = r.with_axis(a, coulomb=0.3 * s * _most(rig, a), warming=1.5)
    return r.with_sensor(rig.positions(a)[0], drift=s * rig.reach[a], drift_time=20.0 + 40.0 * u[0])


def _resonance(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    """A link, or what lies before it, that swings; the other axis stays as good as stiff."""
    r = r.with_rig(yields=1.0)
    for i in range(len(rig.axes)):
        inertia = rig.reality.physics.of(i, "inertia")
        rate = (60.0 / s if i == a else 250.0) * (0.8 + 0.4 * u[0])
        r = r.with_axis(i, stiffness=inertia * rate**2, damping=2 * (0.02 if i == a else 0.3) * inertia * rate)
    return r


def _other_friction(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, other_friction=s * _most(rig, a) / rig.reach[1 - a])


def _drag(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, drag=s * _most(rig, a) / _speed(rig, a) ** 2)


def _tight(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_axis(a, tight=s * _most(rig, a), tight_period=rig.reach[a] * (0.5 + u[0]))


def _irregular(rig: Rig, r: Reality, a: int, place: str, s: float, u: Array) -> Reality:
    return r.with_path(a, lost=min(0.8, s), delay_jitter=0.1 * s)


FORMS: tuple[Form, ...] = (
    Form("coulomb_friction", "coulomb", 1e-4, 0.4, _coulomb, fits=_dry),
    Form("coulomb_friction", "tanh", 1e-4, 0.4, _tanh, fits=_dry),
    Form("coulomb_friction", "lugre", 1e-4, 0.4, _lugre, fits=_dry, also=("lugre_friction",)),
    Form("coulomb_friction", "dahl", 1e-4, 0.4, _dahl, fits=_dry, also=("lugre_friction",)),
    Form("lugre_friction", "lugre", 1e-4, 0.4, _long_bristles(2), fits=_dry),
    Form("lugre_friction", "dahl", 1e-4, 0.4, _long_bristles(3), fits=_dry),
    Form("constant_torque", "constant", 1e-4, 0.4, _pull, signed=True),
    Form("direction_viscous_friction", "linear", 1e-3, 2.0, _viscous_one_way, signed=True, fits=_unknown_friction),
    Form("viscous_friction", "linear", 1e-3, 2.0, _viscous, fits=_unknown_friction),
    Form("viscous_friction", "grease", 1e-3, 2.0, _grease, fits=_unknown_friction),
    Form("stribeck_friction", "gaussian", 1e-4, 0.4, _stribeck(0), fits=_effort),
    Form("stribeck_friction", "rational", 1e-4, 0.4, _stribeck(1), fits=_effort),
    Form("stribeck_friction", "exponential", 1e-4, 0.4, _stribeck(2), fits=_effort),
    Form("load_friction", "both", 1e-3, 0.45, _load(0), fits=_effort),
    Form("load_friction", "carried", 1e-3, 0.45, _load(1), fits=_effort),
    Form("directional_load_friction", "by power", 1e-3, 0.45, _load_by_power, fits=_effort),
    Form("direction_friction", "coulomb", 1e-4, 0.4, _one_way(0), signed=True, fits=_dry),
    Form("direction_friction", "tanh", 1e-4, 0.4, _one_way(1), signed=True, fits=_dry),
    Form("dead_band", "subtracted", 1e-4, 0.3, _dead_band(0), fits=_effort),
    Form("dead_band", "jump", 1e-4, 0.3, _dead_band(1), fits=_effort),
    Form("rate_limit", "constant", 0.05, 20.0, _rate),
    Form("motion_profile", "trapezoid", 0.005, 2.0, _profile),
    Form("duty_cut_back", "after a time", 1.02, 300.0, _cut_back),
    Form("torque_saturation", "hard", 1.02, 100.0, _saturation(0)),
    Form("torque_saturation", "soft", 0.2, 100.0, _saturation(1)),
    Form("supply_sag", "resistor", 0.05, 20.0, _sag(False), fits=_two, everywhere=True),
    Form("supply_sag", "with capacitor", 0.05, 20.0, _sag(True), fits=_two, everywhere=True),
    Form("command_delay", "fixed", 1e-4, 0.1, _delay(0.0), before=_latest),
    Form("command_delay", "jittering", 1e-4, 0.1, _delay(0.2), before=_latest),
    Form("command_quantisation", "rounded", 1e-3, 0.5, _command_tick(False)),
    Form("command_quantisation", "truncated", 1e-3, 0.5, _command_tick(True)),
    Form("gain_error", "linear", 1e-4, 0.3, _gain, signed=True, fits=_seen_twice),
    Form("positioning_error", "of the target", 1e-4, 0.2, _by_target),
    Form("positioning_error", "of the feedback", 1e-4, 0.2, _by_angle(0)),
    Form("positioning_error", "saw tooth", 1e-4, 0.2, _by_angle(1)),
    Form("gravity_load", "point mass", 1e-4, 1.0, _unbalanced, signed=True),
    Form("gravity_load", "other arm", 1e-4, 1.0, _far_mass, signed=True),
    Form("return_spring", "linear", 1e-4, 1.0, _spring(False)),
    Form("return_spring", "hardening", 1e-4, 1.0, _spring(True)),
    Form("backlash", "dead zone", 1e-4, 0.4, _slack(False)),
    Form("backlash", "contact", 1e-4, 0.4, _slack(True)),
    Form("belt_compliance", "linear", 0.3, 100.0, _soft_belt(False), fits=_belt),
    Form("belt_compliance", "hardening", 0.3, 100.0, _soft_belt(True), fits=_belt),
    Form("cross_coupling", "mixed", 1e-5, 0.3, _crossed, signed=True, fits=_two),
    Form("sensor_bias", "constant", 1e-4, 0.5, _sensor(bias=1.0), signed=True, fits=_seen_twice, sensor=True),
    Form("sensor_gain", "linear", 1e-4, 0.3, _sensor(gain=1.0), signed=True, fits=_seen_twice, sensor=True),
    Form("sensor_delay", "fixed", 1e-5, 0.14, _sensor(delay=1.0), fits=_seen_twice, sensor=True),
    Form("sensor_delay", "jittering", 1e-5, 0.12, _sensor(delay=0.9, delay_jitter=0.2), fits=_seen_twice, sensor=True),
    Form("sensor_lag", "first order", 1e-5, 0.14, _sensor(lag=1.0), fits=_seen_twice, sensor=True),
    Form("sensor_lag", "mean", 1e-3, 0.25, _sensor(lag=1.0, averages=1.0), fits=_seen_twice, sensor=True),
    Form("sensor_quantisation", "rounded", 0.3, 60.0, _coarser(False), fits=_seen_twice, sensor=True),
    Form("sensor_quantisation", "truncated", 0.3, 60.0, _coarser(True), fits=_seen_twice, sensor=True),
    Form("cogging", "sine", 1e-4, 0.3, _cogging, outside=True),
    Form("eccentric_gear", "sine", 1e-4, 0.2, _eccentric, outside=True, fits=_seen_twice),
    Form("loose_mount", "slips", 1e-4, 0.4, _loose_mount, outside=True),
    Form("thermal_drift", "friction and zero", 1e-4, 0.2, _warming, outside=True, fits=_unknown_friction),
    Form("resonance", "flexible link", 0.3, 6.0, _resonance, outside=True, fits=_rigid),
    Form("other_axis_friction", "by its angle", 1e-4, 0.4, _other_friction, outside=True, fits=_two),
    Form("quadratic_drag", "square", 1e-3, 5.0, _drag, outside=True),
    Form("tight_places", "half waves", 1e-4, 0.4, _tight, outside=True),
    Form("irregular_commands", "lost and late", 0.01, 0.8, _irregular, outside=True),
)
"""Every form; those that share an effect are equally likely."""

CONTAINED_BY = {
    "coulomb_friction": ("stribeck_friction", "lugre_friction"),  # of a high speed; of short bristles
    "rate_limit": ("motion_profile",),
    "load_friction": ("directional_load_friction",),
    "torque_saturation": ("supply_sag", "duty_cut_back"),  # of a bound that is also the share
    "sensor_delay": ("sensor_lag",),
}
"""Effects of the library that can be as good as another, so that leaving out one leaves out both."""


def forms_of(rig: Rig, outside: bool) -> list[tuple[Form, int, str]]:
    """Every form that a rig can have: form, number of the axis, place."""
    possible = []
    for form in FORMS:
        if form.outside != outside:
            continue
        for axis, name in enumerate(rig.axes):
            if form.fits(rig, axis):
                places = rig.positions(axis) if form.sensor else (name,)
                possible += [(form, axis, place) for place in places]
    return possible
