//! Names of the controller's faults.

use spherecal_shared::protocol::host::Fault;

/// The name of a fault, as in files and on the wire.
pub fn fault_name(fault: Fault) -> String {
    serde_json::to_value(fault)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default()
}
