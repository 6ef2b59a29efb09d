//! The studies as their users run them.
#![cfg(unix)]

mod program;
