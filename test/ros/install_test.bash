#!/usr/bin/env bash
# Usage: install_test.bash BUILD PREFIX PYTHON REPLAY_TEST ARGUMENT...
#
# Installs the build to PREFIX, the prefix it was configured for, and with nothing but the install
# space in the environment builds a program that uses the core, and replays a bag.
set -euo pipefail

build=$1 prefix=$2 python=$3
shift 3
rm -rf "${prefix}"
cmake --install "${build}" >/dev/null
ros=/opt/ros/noetic/setup.bash
env --ignore-environment HOME="${HOME}" PATH=/usr/bin:/bin PREFIX="${prefix}" ROS="${ros}" \
  PYTHON="${python}" LIBRARY_TEST="$(dirname "${BASH_SOURCE[0]}")/../library_test.py" bash -c '
    [ ! -f "${ROS}" ] || . "${ROS}"
    . "${PREFIX}/setup.bash"
    case "$(rospack find field_phenotyping)" in
      "${PREFIX}"/*) ;;
      *) echo "the package is not found in the install space" >&2; exit 1 ;;
    esac
    rosrun field_phenotyping phenotype_cloud --help >/dev/null
    rosrun field_phenotyping simulate_field --help >/dev/null
    rosrun field_phenotyping evaluate --help >/dev/null
    "${PYTHON}" "${LIBRARY_TEST}" "${PREFIX}"
    exec "${PYTHON}" "$@"
  ' install_test "$@"
