//! Empty: only the dependencies in `Cargo.toml` matter. They unify features, so that all builds share one copy of each.
