# SPDX-License-Identifier: Apache-2.0
"""Cross-axis coupling."""

import mujoco

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Added
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command(values: Values, site: Site, step: float, start: Array) -> Added | None:
    share = values["share"][:, None]
    return None if site.the_axis.belt else Added(lambda target: share * target, site.others)


def spec(spec: mujoco.MjSpec, site: Site) -> None:
    if site.the_axis.belt:
        for other in site.others:
            spec.tendon(site.the_axis.belt).wrap_joint(site.rig.axes[other].load, 0.0)


def fields(fields: Fields, site: Site, values: Values) -> None:
    if site.tendon < 0:
        return
    mj = fields.model
    first = int(mj.tendon_adr[site.tendon])
    loads = {mj.joint(site.rig.axes[other].load).id for other in site.others}
    for wrap in range(first + 2, first + int(mj.tendon_num[site.tendon])):
        if int(mj.wrap_objid[wrap]) in loads:
            fields["wrap_prm"][:, wrap] = values["share"]


EFFECT = Effect(
    name="cross_coupling",
    title="Cross-axis coupling",
    physics="Tilting the other axis also turns this one, for example because its belt runs over the other axis.",
    equation="load = r motor + c other load (with a belt); u' = u + c u_other (without)",
    parameters=(
        Parameter(
            "share", "1", -0.3, 0.3, 0.0, 0.05, "belts are led close to the other axis; a third would be noticed by eye"
        ),
    ),
    stage="mjcf",
    mark="This axis moves, in step, whenever only the other one is commanded.",
    shows="coupled",
    confused_with=("board_not_level", "gravity_load"),
    separated_by="Move the axes one after the other: what this axis does while only the other moves is coupling.",
    needs=("other_axis",),
    couples=True,
    order=60,
    command=command,
    spec=spec,
    fields=fields,
)
