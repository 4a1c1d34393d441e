# SPDX-License-Identifier: Apache-2.0
"""Reports at once that the monitor is starting; its libraries, and an emulated rig, take a few seconds."""

import sys
from collections.abc import Sequence


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `ros2 run eps_tunnel_analysis monitor`."""
    words = list(sys.argv[1:] if args is None else args)
    if not {"-h", "--help"} & set(words):
        what = "an emulated rig, its simulation and the monitor" if "--emulated" in words else "the monitor"
        print(f"Starting {what}. The address to open follows in a few seconds.", file=sys.stderr, flush=True)
    from eps_tunnel_analysis.nodes import monitor_node

    return monitor_node.main(words)


if __name__ == "__main__":
    sys.exit(main())
