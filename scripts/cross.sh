#!/bin/sh
# Finds, or installs when asked, what the boards need: a Rust toolchain for the
# Cortex-M7 (thumbv7em-none-eabihf) and QEMU. Builds the boards with it.
#
#   scripts/cross.sh [--install] [--route rustup|debian] [--dry-run] [COMMAND]
#
#   check            say which route and which QEMU were found (the default)
#   build [BOARD..]  build the images in release: mps2-an500 nucleo-h743zi nucleo-h743zi-uart
#                    (its drive on the UART); and mps2-an386, the first one's sources for
#                    a Cortex-M4F
#   stack [BOARD]    build an image that says its functions' stack sizes, for the tests
#   prove            link the control path with a panic handler that does not exist
#   portable         build the controller for Arm cores without a double-precision FPU,
#                    and check the skeleton of a board
#   cargo ARGS..     any other Cargo command in firmware/boards, same toolchain
#
#   --install        install what is missing (rustup first, apt-get second)
#   --route          use this route or none; the default is the first that works
#   --dry-run        print every command instead of running it
#
# Exit codes: 0 done; 1 a command failed; 2 wrong usage; 3 something is missing
# and --install was not given, or did not help.
set -eu

target=thumbv7em-none-eabihf
# Cortex-M4 with software floating point, and Cortex-M3.
portable_targets="thumbv7em-none-eabi thumbv7m-none-eabi"
# The NUCLEO with its drive on the UART instead of Ethernet.
uart_board=nucleo-h743zi-uart
boards="mps2-an500 nucleo-h743zi $uart_board"
# The same sources for a Cortex-M4F: single-precision FPU, f64 by library.
m4_board=mps2-an386
root=$(cd "$(dirname "$0")/.." && pwd)
install=no dry=no want=

usage() { sed -n '2,/^set -eu/p' "$0" | sed -n 's/^# \{0,1\}//p' >&2; exit 2; }
say() { printf 'cross: %s\n' "$*" >&2; }
run() {
    if [ "$dry" = yes ]; then printf '+ %s\n' "$*"; else "$@"; fi
}
sudo_if_needed() {
    if [ "$(id -u)" = 0 ]; then run "$@"; else run sudo "$@"; fi
}

while [ $# -gt 0 ]; do
    case $1 in
        --install) install=yes ;;
        --dry-run) dry=yes ;;
        --route) [ $# -ge 2 ] || usage; want=$2; shift ;;
        -h | --help) usage ;;
        -*) say "unknown option $1"; usage ;;
        *) break ;;
    esac
    shift
done
case $want in '' | rustup | debian) ;; *) say "unknown route $want"; usage ;; esac
command=${1:-check}
[ $# -eq 0 ] || shift

# --- the two routes -----------------------------------------------------------

# The toolchain in PATH has the target's core library: rustup installed it.
have_rustup() {
    sysroot=$(cd / && rustc --print sysroot 2>/dev/null) && [ -d "$sysroot/lib/rustlib/$target/lib" ]
}
# A distribution's compiler with the library's sources: core is built from them.
have_debian() {
    [ -x /usr/bin/rustc ] && [ -x /usr/bin/cargo ] &&
        [ -d "$(/usr/bin/rustc --print sysroot)/lib/rustlib/src/rust/library/core" ] && [ -n "$(lld)" ]
}
# LLVM's linker: rustup's, the distribution's Rust's, or the distribution's own.
lld() {
    for compiler in rustc /usr/bin/rustc; do
        sysroot=$(cd / && $compiler --print sysroot 2>/dev/null) || continue
        for linker in "$sysroot"/lib/rustlib/*/bin/rust-lld; do
            [ -x "$linker" ] && printf '%s\n' "$linker" && return
        done
    done
    command -v rust-lld || command -v ld.lld || true
}
qemu() { command -v qemu-system-arm || true; }

apt_updated=no
apt_install() {
    command -v apt-get >/dev/null || { say "no apt-get here: install $* by hand"; return 1; }
    [ "$apt_updated" = yes ] || sudo_if_needed apt-get update -q || return 1
    apt_updated=yes
    sudo_if_needed env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "$@"
}
install_rustup() {
    command -v rustup >/dev/null || return 1
    run rustup target add $target
}
install_debian() {
    apt_install rustc-web rust-web-src cargo-web || return 1
    [ "$dry" = yes ] || [ -n "$(lld)" ] || apt_install lld
}

allowed() { [ -z "$want" ] || [ "$want" = "$1" ]; }
find_route() {
    for candidate in rustup debian; do
        if allowed $candidate && "have_$candidate"; then route=$candidate; return 0; fi
    done
    return 1
}

route=
if [ "$dry" = yes ] && [ -n "$want" ]; then
    # A dry run shows the route asked for even where it is not installed.
    route=$want
    "have_$want" || { [ "$install" = no ] || "install_$want"; }
elif ! find_route && [ "$install" = yes ]; then
    for candidate in rustup debian; do
        allowed $candidate || continue
        say "installing the cross toolchain by way of $candidate"
        "install_$candidate" || { say "$candidate: not possible here"; continue; }
        find_route && break
        [ "$dry" = no ] || { route=$candidate; break; }
    done
fi
if [ -z "$(qemu)" ] && [ "$install" = yes ]; then
    say "installing QEMU"
    apt_install qemu-system-arm || say "QEMU could not be installed"
fi

missing=no
case $route in
    rustup) say "route rustup: $(rustc --version), target $target" ;;
    debian) say "route debian: $(/usr/bin/rustc --version 2>/dev/null || echo '/usr/bin/rustc'), core built from source, linker $(lld)" ;;
    *)
        missing=yes
        say "no Cortex-M7 toolchain: 'rustup target add $target', or Debian's rustc-web rust-web-src cargo-web (or run $0 --install)"
        ;;
esac
if [ -n "$(qemu)" ]; then
    say "QEMU: $(qemu), $(qemu-system-arm --version | head -n 1)"
elif [ "$command" = check ]; then
    missing=yes
    say "no qemu-system-arm: install Debian's qemu-system-arm (or run $0 --install)"
fi
[ "$missing" = no ] || [ "$dry" = yes ] || exit 3

# --- Cargo with that route ----------------------------------------------------

# What the banner says of the build: the last commit that touched its sources.
build_hash() {
    hash=$(git -C "$root" log -1 --abbrev=12 --format=%h -- firmware shared 2>/dev/null) || hash=
    [ -n "$hash" ] || { echo unknown; return; }
    git -C "$root" diff --quiet HEAD -- firmware shared || hash=$hash-dirty
    echo "$hash"
}

cross_cargo() {
    # Cargo reads .cargo/config.toml (target, CPU, linker script) from there.
    [ "$dry" = no ] && cd "$root/firmware/boards" || printf '+ cd %s\n' "$root/firmware/boards"
    [ -n "${SPHERECAL_BUILD:-}" ] || SPHERECAL_BUILD=$(build_hash)
    export SPHERECAL_BUILD
    case $route in
        debian)
            run env RUSTC=/usr/bin/rustc RUSTDOC=/usr/bin/rustdoc RUSTC_BOOTSTRAP=1 \
                CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER="$(lld)" CARGO_UNSTABLE_BUILD_STD=core \
                /usr/bin/cargo "$@"
            ;;
        *) run cargo "$@" ;;
    esac
}

case $command in
    check) ;;
    build)
        [ $# -gt 0 ] || set -- $boards
        for board in "$@"; do
            if [ "$board" = "$m4_board" ]; then
                # The variable replaces the flags of the configuration; `--config` would add to them.
                export RUSTFLAGS="-C target-cpu=cortex-m4"
                (cross_cargo build --release --locked --package mps2-an500 --bin mps2-an500 --target-dir ../../target/boards-m4)
                unset RUSTFLAGS
                [ "$dry" = yes ] || printf '%s\n' "$root/target/boards-m4/$target/release/mps2-an500"
                continue
            fi
            package=$board features= release=$root/target/boards/$target/release
            [ "$board" != "$uart_board" ] || package=nucleo-h743zi features="--features uart-drive"
            [ -d "$root/firmware/boards/$package" ] || { say "no board $board: there are $boards $m4_board"; exit 2; }
            # shellcheck disable=SC2086 # two words, or none
            (cross_cargo build --release --locked --package "$package" $features)
            # Two images of one name: Cargo keeps both, and puts one there again when it is built again.
            [ "$board" = "$package" ] || run mv "$release/$package" "$release/$board"
            [ "$dry" = yes ] && continue
            # The NUCLEO tests its flash at the start. Without Python the image says that it is not sealed.
            if [ "$package" = nucleo-h743zi ] && command -v python3 >/dev/null; then
                "$root/scripts/seal" "$release/$board"
            fi
            printf '%s\n' "$release/$board"
        done
        ;;
    stack)
        # A compiler switch that is not stable yet, for measuring only; the
        # code is the same.
        [ $# -gt 0 ] || set -- mps2-an500
        export RUSTC_BOOTSTRAP=1
        (cross_cargo build --release --locked --package "$1" --target-dir ../../target/stack \
            --config "target.$target.rustflags=['-Zemit-stack-sizes']")
        [ "$dry" = yes ] || printf '%s\n' "$root/target/stack/$target/release/$1"
        ;;
    prove)
        cross_cargo build --release --locked --package mps2-an500 --features panic-free --bin control
        [ "$dry" = yes ] || say "the control path links without a way to panic"
        ;;
    portable)
        for core in $portable_targets; do
            if [ "$route" = rustup ] && [ "$dry" = no ] && [ ! -d "$(cd / && rustc --print sysroot)/lib/rustlib/$core/lib" ]; then
                [ "$install" = yes ] || { say "no $core: 'rustup target add $core' (or run $0 --install portable)"; exit 3; }
                run rustup target add "$core"
            fi
            (cross_cargo build --release --locked --package spherecal-firmware --target "$core")
            [ "$dry" = yes ] || say "the controller builds for $core"
        done
        (cross_cargo check --release --locked --package nucleo-h743zi --example skeleton)
        [ "$dry" = yes ] || say "the skeleton of a board is checked"
        ;;
    cargo) [ $# -gt 0 ] || usage; cross_cargo "$@" ;;
    *) say "unknown command $command"; usage ;;
esac
