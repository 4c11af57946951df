//! The float network: configuration, layers, losses, schedule, loop, checkpoint.

mod config;

pub use config::NetworkConfig;
