//! Which Arm targets have an FPU for `f64`. Used by the build script.
//!
//! A stable compiler does not pass the features of an Arm core to
//! `cfg(target_feature)`. The compiler flags name the core, so they are read too.

/// Cores whose FPU computes in double precision by default.
const F64_CORES: [&str; 5] = ["cortex-m7", "cortex-m55", "cortex-m85", "cortex-r5", "cortex-r52"];

/// Whether the square-root instruction for `f64` may be used.
///
/// `arch`, `abi` and `features` are Cargo's `CARGO_CFG_TARGET_*` values;
/// `flags` are the compiler flags, separated by `\x1f`
/// (`CARGO_ENCODED_RUSTFLAGS`). The answer is `false` when nothing proves that
/// the instruction exists.
pub(crate) fn has_f64_fpu(arch: &str, abi: &str, features: &str, flags: &str) -> bool {
    if arch != "arm" || abi != "eabihf" {
        return false;
    }
    if flags.contains("-fp64") {
        return false;
    }
    // `vfp2` includes double precision in the compiler's terms.
    let by_feature = features
        .split(',')
        .any(|feature| feature == "vfp2" || feature == "fp64");
    let by_core = flags
        .split('\x1f')
        .filter_map(|flag| flag.rsplit_once("target-cpu="))
        .any(|(_, core)| F64_CORES.contains(&core));
    by_feature || by_core || flags.contains("+fp64")
}

#[cfg(test)]
mod tests {
    use super::has_f64_fpu;

    // Fails if a core without a double-precision FPU gets the instruction, or
    // the Cortex-M7 of the boards does not.
    #[test]
    fn only_cores_with_a_double_precision_fpu_qualify() {
        let m7 = "-C\x1ftarget-cpu=cortex-m7";
        assert!(has_f64_fpu("arm", "eabihf", "", m7));
        assert!(has_f64_fpu("arm", "eabihf", "", "-Ctarget-cpu=cortex-m7"));
        assert!(has_f64_fpu("arm", "eabihf", "dsp,vfp2,mclass", ""));
        // Cortex-M4F: an FPU for f32 only.
        assert!(!has_f64_fpu(
            "arm",
            "eabihf",
            "dsp,mclass",
            "-C\x1ftarget-cpu=cortex-m4"
        ));
        assert!(!has_f64_fpu("arm", "eabihf", "", ""));
        // A Cortex-M7 with the single-precision variant of its FPU.
        assert!(!has_f64_fpu(
            "arm",
            "eabihf",
            "vfp2",
            "-C\x1ftarget-cpu=cortex-m7\x1f-C\x1ftarget-feature=-fp64"
        ));
        // Software floating point, and another architecture.
        assert!(!has_f64_fpu("arm", "eabi", "", m7));
        assert!(!has_f64_fpu("x86_64", "", "", ""));
    }
}
