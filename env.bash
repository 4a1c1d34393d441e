# SPDX-License-Identifier: Apache-2.0
# Source me (bash or zsh) after `make setup`: `source env.bash`. Then `ros2 run labyrinth_sim sim_node` and `eps-tunnel` work.
# Sourced with the word `underlay`, the workspace itself is left out; the build needs that.
#
# A ROS 2 that is already sourced is left as it is, and its own `ros2` comes first. Variables such as ROS_DOMAIN_ID and
# ROS_AUTOMATIC_DISCOVERY_RANGE are never touched: who talks to whom is the user's choice.

if [ -n "${ZSH_VERSION:-}" ]; then
  _eps_here=${0:A:h}
  _eps_shell=zsh
else
  _eps_here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P)
  _eps_shell=bash
fi

# Puts a folder into a colon-separated variable once: _eps_add VARIABLE FOLDER front|back
_eps_add() {
  eval "_eps_old=\${$1:-}"
  case ":$_eps_old:" in
    *":$2:"*) ;;
    ::) export "$1=$2" ;;
    *) if [ "$3" = front ]; then export "$1=$2:$_eps_old"; else export "$1=$_eps_old:$2"; fi ;;
  esac
}

if [ ! -x "$_eps_here/.venv/bin/python" ]; then
  echo "env.bash: $_eps_here/.venv is missing. Run \`make setup\` first." >&2
  unset _eps_here _eps_shell _eps_old
  return 1
fi

_eps_add PATH "$_eps_here/.venv/bin" front
export VIRTUAL_ENV="$_eps_here/.venv"

if [ -f "$_eps_here/.venv/share/ament_index/resource_index/packages/rclpy" ]; then
  # ROS 2 from PyPI. Its wheels would set LD_LIBRARY_PATH by starting Python anew; with everything named here
  # beforehand and the guard set, Python starts once, and so do its children.
  _eps_add AMENT_PREFIX_PATH "$_eps_here/.venv" back
  _eps_add CMAKE_PREFIX_PATH "$_eps_here/.venv" back
  _eps_add LD_LIBRARY_PATH "$_eps_here/.venv/lib" back
  while IFS= read -r _eps_folder; do
    _eps_add LD_LIBRARY_PATH "$_eps_folder" back
  done < <(find "$_eps_here"/.venv/lib/python3*/site-packages -maxdepth 1 -type d -name 'ros_*.libs' | sort)
  export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
fi

if [ "${1:-}" != underlay ]; then
  if [ ! -f "$_eps_here/install/local_setup.$_eps_shell" ]; then
    echo "env.bash: $_eps_here/install is missing. Run \`make setup\` first." >&2
    unset _eps_here _eps_shell _eps_old _eps_folder
    return 1
  fi
  # colcon's scripts read variables that may be unset.
  case $- in *u*) _eps_nounset=1; set +u ;; *) _eps_nounset= ;; esac
  . "$_eps_here/install/local_setup.$_eps_shell"
  [ -z "$_eps_nounset" ] || set -u
  # At the end of PATH: a real `ros2` goes first.
  _eps_add PATH "$_eps_here/tools/bin" back
fi

unset _eps_here _eps_shell _eps_old _eps_folder _eps_nounset
unset -f _eps_add
