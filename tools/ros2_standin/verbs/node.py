# SPDX-License-Identifier: Apache-2.0
"""Various node related sub-commands"""

import argparse
import sys

from ros2_standin import graph
from ros2_standin.verbs import add_verbs

NAME = "node"


def list_(args: argparse.Namespace) -> None:
    """Output a list of available nodes"""
    with graph.direct_node(args) as node:
        names = sorted(graph.node_names(node, args.all))
    if args.count_nodes:
        print(len(names))
    elif names:
        if len(set(names)) < len(names):
            print(
                "WARNING: Be aware that there are nodes in the graph that share an exact name, "
                "which can have unintended side effects.",
                file=sys.stderr,
            )
        print(*names, sep="\n")


def _list_arguments(parser: argparse.ArgumentParser) -> None:
    graph.add_arguments(parser)
    parser.add_argument("-a", "--all", action="store_true", help="Display all nodes even hidden ones")
    parser.add_argument("-c", "--count-nodes", action="store_true", help="Only display the number of nodes discovered")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbs(parser, NAME, {"list": (list_, _list_arguments)})
