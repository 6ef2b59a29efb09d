#!/bin/sh
# Programs that check spherecal's files and services in the tests: readers of MCAP,
# ROS 2 bags, Parquet and URDF, OpenCV, a gRPC client, a headless browser, and PostgreSQL.
#
#   scripts/field.sh install     install what is missing (apt as root or by sudo, PyPI)
set -eu
cd "$(dirname "$0")/.."

[ "${1:-}" = install ] || { sed -n '2,/^set -eu/p' "$0" | sed -n 's/^# \{0,1\}//p' >&2; exit 2; }

scripts/postgres.sh install
if ! command -v chromium >/dev/null && ! command -v chromium-browser >/dev/null; then
    sudo=$(test "$(id -u)" = 0 || echo sudo)
    $sudo apt-get update -q
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends chromium
fi
modules='import cv2, grpc, grpc_tools, mcap, lz4, numpy, pyarrow, rosbags, yourdfpy, yaml, playwright'
if ! target/python/bin/python -c "$modules" 2>/dev/null; then
    rm -rf target/python
    python3 -m venv target/python
    target/python/bin/pip install --quiet grpcio grpcio-tools mcap lz4 numpy opencv-contrib-python-headless pyarrow rosbags yourdfpy pyyaml playwright
    target/python/bin/python -c "$modules"
fi
