# SPDX-License-Identifier: Apache-2.0
import sys

from eps_tunnel_analysis.cli.main import main

sys.exit(main())
