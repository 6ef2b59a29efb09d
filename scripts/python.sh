#!/bin/sh
# The Python package: its wheel, its tests, its notebook.
#
#   scripts/python.sh wheel   build the wheel for release into target/wheels
#   scripts/python.sh test [WHEEL|LIBRARY]
#                             install the package into an empty environment, and run the tests, the examples of the
#                             docstrings and the notebook. WHEEL: the package. LIBRARY: the extension module, already
#                             built (target/debug/lib_native.so of a build of the workspace). Without: maturin builds it
#
#   scripts/python.sh sources install from the sources, as `pip install ./python` does, and run the README's lines
#
# Builds share what they can with the workspace's: one folder, the same profile.
set -eu
cd "$(dirname "$0")/.."

place=$PWD/target/python-package
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/target}"

tools() {
    if ! "$place/tools/bin/maturin" --version >/dev/null 2>&1; then
        rm -rf "$place/tools"
        python3 -m venv "$place/tools"
        "$place/tools/bin/pip" install --quiet 'maturin>=1.8,<2'
    fi
}

case "${1:-}" in
    wheel)
        tools
        # Profile and target as the program of a release: what both need is built once.
        "$place/tools/bin/maturin" build --profile dist --target "$(rustc -vV | sed -n 's/^host: //p')" --features command --locked \
            --manifest-path python/Cargo.toml --out target/wheels
        ;;
    test)
        rm -rf "$place/wheels" "$place/env"
        case "${2:-}" in
        *.whl) mkdir -p "$place/wheels" && cp "$2" "$place/wheels" ;;
        ?*) scripts/wheel "$2" "$place/wheels" ;;
        *)
            tools
            # No tag for other Linux systems: the wheel stays here.
            "$place/tools/bin/maturin" build --profile dev --features command --locked --compatibility linux --quiet \
                --manifest-path python/Cargo.toml --out "$place/wheels"
            ;;
        esac
        python3 -m venv "$place/env"
        "$place/env/bin/pip" install --quiet "$place"/wheels/*.whl
        # What the wheel brings itself must do for all but DataFrames.
        "$place/env/bin/spherecal" --version
        (cd / && "$place/env/bin/python" -c 'import spherecal; print(spherecal.Robot("ur5e").fk([0] * 6).round(3))')
        "$place/env/bin/pip" install --quiet 'pandas>=2' pytest nbclient nbformat ipykernel matplotlib
        # --import-mode: the package that is tested is the installed one, not the folder.
        cd python
        "$place/env/bin/python" -P -m pytest --quiet --import-mode=importlib -p no:cacheprovider tests
        "$place/env/bin/python" -P -m pytest --quiet -p no:cacheprovider --doctest-modules --pyargs spherecal
        ;;
    sources)
        rm -rf "$place/env"
        python3 -m venv "$place/env"
        "$place/env/bin/pip" install --quiet './python[plot]' pytest
        # This build has no command, and says so.
        code=0
        "$place/env/bin/spherecal" --version || code=$?
        [ "$code" = 2 ]
        cd python
        "$place/env/bin/python" -P -m pytest --quiet --import-mode=importlib -p no:cacheprovider tests/test_readme.py tests/test_robot.py
        ;;
    *) sed -n '2,/^set -eu/p' "$0" | sed -n 's/^# \{0,1\}//p' >&2; exit 2 ;;
esac
