//! Sets `cfg(fpu_f64)` where the target has a double-precision FPU.

use std::env;

#[path = "src/detect.rs"]
mod detect;

fn main() {
    let variable = |name: &str| env::var(name).unwrap_or_default();
    println!("cargo::rustc-check-cfg=cfg(fpu_f64)");
    println!("cargo::rerun-if-changed=src/detect.rs");
    if detect::has_f64_fpu(
        &variable("CARGO_CFG_TARGET_ARCH"),
        &variable("CARGO_CFG_TARGET_ABI"),
        &variable("CARGO_CFG_TARGET_FEATURE"),
        &variable("CARGO_ENCODED_RUSTFLAGS"),
    ) {
        println!("cargo::rustc-cfg=fpu_f64");
    }
}
