//! The laser tracker calibration of Section 4.3: base and tool frames from arcs, absolute positions.
