//! `bailando-train`: the offline binary.

fn main() {}
