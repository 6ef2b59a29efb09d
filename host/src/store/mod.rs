//! The store: every recording, contact and fault, written as they arrive.
