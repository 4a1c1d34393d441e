# SPDX-License-Identifier: Apache-2.0
"""The effect file of a formula: its terms as parameters with units and bounds, a mark, and a compiled law."""

import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from eps_tunnel_analysis.law.depends import SWING
from eps_tunnel_analysis.law.formula import ADDS, OF_A_COMMAND, OF_A_SENSOR, TRAVEL, Chosen
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.effect import Effect
from labyrinth_sim.effects.lugre_friction import BRISTLE_TIME
from labyrinth_sim.errors import InputError
from labyrinth_sim.marks import MARKS, Pair
from labyrinth_sim.model import Model
from labyrinth_sim.registry import Registry
from labyrinth_sim.simulate import simulate

NAME = "proposed_effect"
SIGNIFICANT = 3  # figures of a typical value in the file
FIRST_SLOT = 3  # of a law's memory, that holds what a term follows; before it are time, time since reversal, direction
SHOWS = {
    "torque": "by_angle", "friction": "loop", "damping": "passing", "link": "livelier", "bristles": "loop",
    "sensor": "by_angle", "late": "late", "play": "loop", "far_end": "livelier",
    "target": "by_angle", "stepped_target": "stairs", "target_late": "late", "target_lag": "late",
    "target_limit": "passing", "target_profile": "late", "sensor_other": "coupled", "target_other": "coupled",
}  # fmt: skip
"""What a term acts as -> its mark, where no roll-out says which."""
LOOKS = {
    "late": "The axis trails its command by a constant time.",
    "offset": "The axis is off by a constant.",
    "scaled": "The axis moves by a constant factor too far or too little.",
    "loop": "The axis stops short of its target by an amount that depends on the side from which it came.",
    "one_sided": "The axis is off by one amount going up and by another going down.",
    "by_angle": "The axis misses each angle by a different amount.",
    "passing": "The axis trails while it moves and is right at rest.",
    "stairs": "The axis stands still at times while it should move.",
    "adrift": "The axis moves before its command does.",
    "coupled": "This axis moves while only the other one is commanded.",
    "calmer": "The axis travels a shorter way.",
    "livelier": "The axis travels a longer way.",
}
"""Mark -> what it looks like, for people."""
MISTAKEN = {
    "torque": ("gravity_load", "return_spring", "positioning_error"),
    "friction": ("coulomb_friction", "load_friction", "stribeck_friction"),
    "damping": ("viscous_friction", "supply_sag"),
    "link": ("belt_compliance", "sensor_lag"),
    "bristles": ("lugre_friction", "coulomb_friction", "backlash"),
    "sensor": ("sensor_gain", "sensor_bias"),
    "late": ("sensor_delay", "sensor_lag"),
    "play": ("backlash", "sensor_quantisation"),
    "far_end": ("sensor_lag", "belt_compliance"),
    "sensor_other": ("cross_coupling", "sensor_bias"),
    "target": ("positioning_error", "gain_error"),
    "target_other": ("cross_coupling", "gravity_load"),
    "stepped_target": ("command_quantisation", "dead_band"),
    "target_late": ("command_delay", "rate_limit"),
    "target_lag": ("motion_profile", "command_delay"),
    "target_limit": ("rate_limit", "torque_saturation"),
    "target_profile": ("motion_profile", "command_delay"),
}
TOUCHES = {"friction": "dof_frictionloss", "damping": "dof_damping", "bristles": "dof_damping", "link": "dof_armature"}
"""What a term of a force acts as -> the model's field that its law writes."""
FILTERS = {
    "target": "Map(lambda target: target + {sum})",
    "target_other": "Added(lambda other: {sum}, site.others[:1])",
    "stepped_target": "Map(lambda target: rounded(target, {sum}))",
    "target_late": "Delay({sum}, step, start)",
    "target_lag": "Lag({sum}, step)",
    "target_limit": "RateLimit(1.0 / np.maximum({sum}, 1e-9), {sum} <= 0.0, step, start)",
    "target_profile": "Profile(np.where({sum} > 0.0, 1.0 / np.maximum({sum}, 1e-9), np.inf), "
    "np.full_like(start, np.inf), step, start)",
    "far_end": "Swing({sum}, step)",
    "play": "Play({sum})",
    "late": "Delay({sum}, step, start, smooth=True)",
    "sensor": "Map(lambda angle: angle + {sum})",
    "sensor_other": "Added(lambda other: {sum}, site.other_seen)",
}
"""What a term of a sensor or the command acts as -> the filter that it is, with the sum of such terms; in the order of
the rig.
"""
FILTER_NAMES = sorted({"Chain", *re.findall(r"\b([A-Z]\w+|rounded)\(", " ".join(FILTERS.values()))})
"""What a file may import for them."""


def prefixes(terms: Sequence[Chosen]) -> list[str]:
    """A prefix for each term's parameters: its name, numbered where it occurs again."""
    used: list[str] = []
    for chosen in terms:
        name = chosen.term.name
        used.append(name if name not in used else f"{name}{1 + sum(f.startswith(name) for f in used)}")
    return used


def equation_of(terms: Sequence[Chosen]) -> str:
    """The sum of the terms, for people."""
    return " + ".join(c.term.equation for c in terms).replace("+ -", "- ")


def effect_file(terms: Sequence[Chosen], shows: str = "") -> str:
    """The text of a file that declares an effect with these terms, all of a force, of a sensor, or of the command.

    Args:
        shows: its mark, from `seen_mark`; by default what terms like the first one mostly show.
    """
    names = prefixes(terms)
    acts = [c.term.acts for c in terms]
    needs = {c.term.needs for c in terms}
    code = {
        kind: [_code(c, name) for c, name in zip(terms, names, strict=True) if c.term.acts == kind] for kind in acts
    }
    parameters = [line for c, name in zip(terms, names, strict=True) for line in _parameters(c, name)]
    sensor, command = acts[0] in OF_A_SENSOR, acts[0] in OF_A_COMMAND
    hook = "measure" if sensor else "command" if command else "step"
    equation = equation_of(terms)
    if not shows:
        shows = "coupled" if needs == {"other_axis"} and acts[0] == "torque" else SHOWS[acts[0]]
    touches = tuple(TOUCHES[a] for a in dict.fromkeys(acts) if a in TOUCHES)
    own = [f"{name}_{n.name}" for c, name in zip(terms, names, strict=True) for n in c.term.numbers]
    follows = {name: c.term.follows for c, name in zip(terms, names, strict=True) if c.term.follows}
    body = _step(code, needs, own, follows) if hook == "step" else _filtered(code, hook)
    result = "angle' = angle + " if sensor else "command' = command + " if command else "torque = "
    filters = ", ".join(name for name in FILTER_NAMES if f"{name}(" in body)
    imports = (
        "from labyrinth_sim.effect import Effect, Parameter, Values\n"
        f"from labyrinth_sim.filters import {filters}\nfrom labyrinth_sim.site import Site\n"
        "from labyrinth_sim.trials import Array\n"
        if hook != "step"
        else "from labyrinth_sim.effect import Effect, Parameter\nfrom labyrinth_sim.law import law, state\n"
    )
    for module in ("math", "numpy as np"):
        if f"{module.rpartition(' ')[2]}." in body:
            imports = f"import {module}\n\n{imports}"
    what = "a sensor is off" if sensor else "the command is off" if command else "a force acts"
    lines = [
        "# SPDX-License-Identifier: Apache-2.0",
        '"""An effect that was found in recordings and not confirmed yet: say what it is, and give it a name."""',
        "",
        imports,
        "",
        body,
        "",
        "EFFECT = Effect(",
        f'    name="{NAME}",',
        f'    title="Found: {equation}",',
        f'    physics="Not known yet; {what} by this formula, found in recordings.",',
        f'    equation="{(result + equation).replace("+ -", "- ")}",',
        "    parameters=(",
        *parameters,
        "    ),",
        f'    stage="{"measurement" if sensor else "command" if command else "force"}",',
        f'    mark="{LOOKS[shows]}",',
        f'    shows="{shows}",',
        f"    confused_with={MISTAKEN[acts[0]]!r},".replace("'", '"'),
        '    separated_by="Play another command: a law holds there as well.",',
    ]
    if "other_axis" in needs:
        lines += ['    needs=("other_axis",),', "    couples=True,"]
    if sensor:
        lines += ['    where="signal",', "    measure=measure,"]
    elif command:
        lines.append("    command=command,")
    else:
        if touches:
            lines.append(f"    touches={touches!r},".replace("'", '"'))
        lines.append("    step=step,")
    return "\n".join([*lines, ")", ""])


def _code(chosen: Chosen, prefix: str) -> str:
    if chosen.term.acts in OF_A_SENSOR | OF_A_COMMAND:
        each = "[:, None]" if chosen.term.acts in ADDS else ""
        return chosen.term.formula.format(**{n.name: f'values["{prefix}_{n.name}"]{each}' for n in chosen.term.numbers})
    places = {n.name: f"{prefix}_{n.name}" for n in chosen.term.numbers} | {"followed": f"{prefix}_followed"}
    return chosen.term.formula.format(**places).replace("np.abs", "abs").replace("np.", "math.")


def _parameters(chosen: Chosen, prefix: str) -> list[str]:
    lines = []
    for number in chosen.term.numbers:
        value = float(f"{chosen.values[number.name]:.{SIGNIFICANT}g}")
        if not number.times:
            low, high, why = -3.2, 3.2, "a full period"
        elif number.switches:
            most = float(f"{max(number.times * abs(value), 1e-9):.2g}")
            low, high, why = -most, most, f"{number.times:g} times what was found, of either sign"
            if number.signed:
                low, high = (0.0, most) if value >= 0.0 else (-most, 0.0)
                why = f"{number.times:g} times what was found, of its sign"
            if high > number.most:
                high, why = max(number.most, value), f"0 to the largest for such an effect, {number.most:g}"
        else:
            low, high = (float(f"{v:.3g}") for v in (value / number.times, value * number.times))
            why = f"found, within a factor of {number.times:g}"
        off = "0.0" if number.switches else "None"
        lines.append(
            f'        Parameter("{prefix}_{number.name}", "{number.unit}", {low!r}, {high!r}, {off}, {value!r}, '
            f'"{why}", "bounds"),'
        )
    return lines


def _step(
    code: Mapping[str, Sequence[str]], needs: set[str], names: Sequence[str], follows: Mapping[str, str]
) -> str:  # fmt: skip
    every = " ".join(text for texts in code.values() for text in texts)
    lines = ["@law", "def step(raw: int) -> None:", "    s = state(raw)"]
    lines += [f"    {name} = s.values[{i}]" for i, name in enumerate(names)]
    if "angle" in every or {"angle", SWING} & {*follows.values()}:
        lines.append("    angle = s.qpos[s.angle]")
    if "speed" in every or {"speed", SWING, TRAVEL} & {*follows.values()} or "memory" in needs:
        lines.append("    speed = s.qvel[s.dof]")
    if "other" in every:
        lines.append("    other = s.qpos[s.drives[1 if s.channel == 0 else 0, 2]]")
    if "carried" in every:
        lines.append("    carried = abs(s.actuator[s.dof] - s.passive[s.dof] + s.bias[s.dof])")
    if "memory" in needs or follows:
        lines.append("    time = s.memory[0]")
    slot, of_two = FIRST_SLOT, {SWING: _swinging, TRAVEL: _bent}
    for prefix, what in follows.items():
        lines += of_two[what](prefix, slot) if what in of_two else _late(prefix, what, slot)
        slot += 2 if what in of_two else 1
    if "memory" in needs:
        lines += [
            "    direction = s.memory[2]",
            "    now = math.copysign(1.0, speed) if abs(speed) > 1e-3 else direction",
            "    since = 0.0 if now != direction else s.memory[1] + s.step",
            "    s.memory[1], s.memory[2] = since, now",
        ]
    if "memory" in needs or follows:
        lines.append("    s.memory[0] = time + s.step")
    if "link" in code:  # what swings on the joint is no longer a part of it
        (inertia,) = code["link"]
        swings = inertia.removesuffix("_inertia")
        lines += [f"    s.armature[s.dof] -= {inertia}", f"    s.applied[s.dof] -= {inertia} * {swings}_followed"]
    if "bristles" in code:  # implicit in the step to come, so that any stiffness is stable
        bristles = code["bristles"][0].partition("_size")[0]
        lines += [
            f"    s.applied[s.dof] -= {bristles}_pull * {bristles}_followed",
            f"    s.damping[s.dof] += {bristles}_stiff * ({BRISTLE_TIME} + s.step) / {bristles}_slides",
        ]
    if "torque" in code:
        lines.append(f"    s.applied[s.dof] += {' + '.join(code['torque'])}")
    if "friction" in code:
        lines.append(f"    friction = {' + '.join(code['friction'])}")
        lines.append("    s.frictionloss[s.dof] = max(s.frictionloss[s.dof] + friction, 0.0)")
    if "damping" in code:
        lines.append(f"    damping = {' + '.join(code['damping'])}")
        lines.append("    s.damping[s.dof] = max(s.damping[s.dof] + damping, 0.0)")
    return "\n".join([*lines, ""])


def _late(prefix: str, what: str, slot: int) -> list[str]:
    """Lines by which a first-order memory follows a variable; it takes one slot."""
    return [
        f"    {prefix}_followed = {what} if time == 0.0 else s.memory[{slot}]",
        f"    {prefix}_followed += (1.0 - math.exp(-s.step / {prefix}_after)) * ({what} - {prefix}_followed)",
        f"    s.memory[{slot}] = {prefix}_followed",
    ]


def _swinging(prefix: str, slot: int) -> list[str]:
    """Lines by which a mass on a spring follows the joint, its acceleration at the end; it takes two slots."""
    return [
        f"    {prefix}_place = angle if time == 0.0 else s.memory[{slot}]",
        f"    {prefix}_rate = speed if time == 0.0 else s.memory[{slot + 1}]",
        f"    {prefix}_followed = {prefix}_frequency**2 * (angle - {prefix}_place)",
        f"    {prefix}_followed += 2.0 * {prefix}_damping * {prefix}_frequency * (speed - {prefix}_rate)",
        f"    {prefix}_rate += s.step * {prefix}_followed",
        f"    s.memory[{slot}], s.memory[{slot + 1}] = {prefix}_place + s.step * {prefix}_rate, {prefix}_rate",
    ]


def _bent(prefix: str, slot: int) -> list[str]:
    """Lines by which bristles bend with the joint's travel; they take two slots.

    After a step h to a speed v' they are bent by z' = (z + h v') / (1 + h |v| / b), as far as the present speed v lets
    them slide, and the torque F/b z' with its damping is linear in v'.
    """
    damps = f"{BRISTLE_TIME} / s.step"
    return [
        f"    {prefix}_slides = 1.0 + s.step * abs(speed) / {prefix}_bend",
        f"    {prefix}_before = s.memory[{slot + 1}] if time > 0.0 else 1.0",
        f"    {prefix}_followed = (s.memory[{slot}] + s.step * speed) / {prefix}_before if time > 0.0 else 0.0",
        f"    s.memory[{slot}], s.memory[{slot + 1}] = {prefix}_followed, {prefix}_slides",
        f"    {prefix}_stiff = {prefix}_size / {prefix}_bend",
        f"    {prefix}_pull = {prefix}_stiff * ((1.0 + {damps}) / {prefix}_slides - {damps})",
    ]


def _filtered(code: Mapping[str, Sequence[str]], hook: str) -> str:
    """A hook that makes the filters of these terms, `measure` or `command`."""
    filters = [made.format(sum=" + ".join(code[kind])) for kind, made in FILTERS.items() if kind in code]
    one = len(filters) == 1
    kind, made = filters[0].partition("(")[0] if one else "Chain", filters[0] if one else f"Chain({', '.join(filters)})"
    return f"def {hook}(values: Values, site: Site, step: float, start: Array) -> {kind}:\n    return {made}\n"


_FOLDERS: list[tempfile.TemporaryDirectory[str]] = []  # of files that compiled laws came from, kept as long as they are


def declared(text: str) -> Effect:
    """The effect that the text of a file declares."""
    _FOLDERS.append(tempfile.TemporaryDirectory())
    folder = Path(_FOLDERS[-1].name)
    (folder / f"{NAME}.py").write_text(text, encoding="utf-8")
    return Registry.load(folder).effect(NAME)


def seen_mark(model: Model, effect: Effect, place: str, play: Play) -> str:
    """The mark that explains most of what an effect changes in the first trial of a play; "" if it cannot be played.

    Args:
        model: without the effect; `place`, where it acts.
    """
    rig, trials = model.rig, play.trials
    axis = next(a for a in rig.axes if place == a.name or place in [m.signal for m in a.measured])
    positions = [m for m in axis.measured if m.quantity == "position"]
    signal = next((m.signal for m in positions if place in (m.signal, axis.name) and m.joint == axis.load), place)
    try:
        without, seen = (simulate(m, trials) for m in (model, model.with_effect(effect, place)))
    except InputError:
        return ""
    column = without.index(signal)
    others = [signal for a in rig.axes if a is not axis for signal in a.positions]
    other = without.values[0, :, without.index(others[0])] if others else np.zeros(len(trials.time))
    command = np.nan_to_num(without.commands[0][:, rig.command_channels.index(axis.command)])
    pair = Pair(trials.step, command, without.values[0, :, column], seen.values[0, :, column], other)
    return max(MARKS, key=lambda name: MARKS[name](pair))
