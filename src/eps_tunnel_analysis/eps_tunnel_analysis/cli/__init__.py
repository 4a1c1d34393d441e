# SPDX-License-Identifier: Apache-2.0
"""The command line. Each module that declares NAME, HELP, add_arguments and run is a command."""
