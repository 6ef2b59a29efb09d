//! Every message against the documented layout, byte by byte, and every decoder against arbitrary bytes.

mod hostile;
mod layout;
mod precision;
mod requests;

use spherecal_fci::wire::*;

/// First byte of: motion generator mode, controller mode, errors, reflex reason, robot mode, success rate.
fn tail(version: Version) -> [usize; 6] {
    match version {
        Version::V4 => [2256, 2257, 2258, 2295, 2332, 2333],
        Version::V10 => [1288, 1289, 1290, 1331, 1372, 1373],
        _ => [2280, 2281, 2282, 2323, 2364, 2365],
    }
}

fn number_at(bytes: &[u8], version: Version, offset: usize) -> f64 {
    if version == Version::V10 {
        f32::from_le_bytes(bytes[offset..offset + 4].try_into().expect("4 bytes")).into()
    } else {
        f64::from_le_bytes(bytes[offset..offset + 8].try_into().expect("8 bytes"))
    }
}
