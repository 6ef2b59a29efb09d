#!/bin/sh
# Client libraries that others wrote, unchanged, against our robot sides: Franka's own, and ur-rtde for Universal Robots.
#
#   scripts/official-clients.sh install   install panda-python, pylibfranka and ur-rtde under target/ (PyPI)
#   scripts/official-clients.sh test      install, then run the conformance tests
set -eu
cd "$(dirname "$0")/.."

venv=target/official-clients
modules='import panda_py, pylibfranka, rtde_receive'

install() {
    if ! $venv/bin/python -c "$modules" 2>/dev/null; then
        rm -rf $venv
        python3 -m venv $venv
        $venv/bin/pip install --quiet panda-python==1.1.1 pylibfranka==0.21.3 ur-rtde==1.6.5 numpy
        $venv/bin/python -c "$modules"
    fi
}

case "${1:-}" in
    install) install ;;
    test)
        install
        SPHERECAL_REQUIRE_FIELD=1 cargo test -p spherecal-fci --test fci official_clients
        SPHERECAL_REQUIRE_FIELD=1 cargo test -p spherecal-ur --test ur official_client -- --include-ignored
        SPHERECAL_REQUIRE_FIELD=1 cargo test -p spherecal --all-features --test cli official_clients -- --include-ignored
        ;;
    *) sed -n '2,/^set -eu/p' "$0" | sed -n 's/^# \{0,1\}//p' >&2; exit 2 ;;
esac
