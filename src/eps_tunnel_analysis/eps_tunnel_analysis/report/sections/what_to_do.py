# SPDX-License-Identifier: Apache-2.0
"""What to do next: the command line, or the experiment."""

from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
from eps_tunnel_analysis.report.page import Block, Facts, Section, Text

NEXT = {
    "complete": "Nothing: the model is as good as these recordings can tell. Sharper ones may tell more.",
    "unknown": "Look at the evidence above. If you know what it is, write it as an effect file of your own and "
    "diagnose again with --effects.",
}


def what_to_do(diagnosis: Diagnosis, add: str) -> Section:
    """The command line that adds what is named; the experiment that decides, where one is needed."""
    v = diagnosis.verdict
    blocks: list[Block] = []
    if v.verdict in NEXT:
        blocks.append(Text(NEXT[v.verdict]))
    if v.verdict == "effect":
        blocks += [Text("Add it, fit it, and prove it on samples held out:"), Facts([("run", add)])]
    if diagnosis.experiment:
        e = diagnosis.experiment
        blocks += [
            Text(e.reason),
            Facts([("play", f"next_experiment.yaml ({e.name})"), ("then", "diagnose all recordings together")]),
        ]
    if v.values:
        blocks.append(Facts([(name, f"{value:.5g}") for name, value in v.values.items()]))
    return Section("What to do", blocks)
