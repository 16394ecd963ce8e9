//! The command `palpate`.
fn main() {}
