//! KUKA FRI.
