//! Names by which QEMU and the image are found.

/// QEMU's program.
pub const PROGRAM: &str = "qemu-system-arm";
/// Environment variable that names an image.
pub const IMAGE_VARIABLE: &str = "SPHERECAL_QEMU_IMAGE";
