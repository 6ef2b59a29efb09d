//! The `spherecal` program: see [`spherecal::cli`].

fn main() {}
