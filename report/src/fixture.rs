//! Servo sessions for unit tests.

use eval::policy::oracle::Oracle;
use eval::{EvalConfig, Policies, SessionRecord, run_sessions};
use std::sync::atomic::AtomicBool;
use world::{Environment, WorldConfig};

/// The environment of `configs/world.toml`.
pub(crate) fn environment() -> Environment {
    let config: WorldConfig = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
    Environment::new(&config).unwrap()
}

/// The first sessions of Table 1 with oracles, with one obstacle each.
pub(crate) fn sessions(count: usize) -> Vec<SessionRecord> {
    let mut table: toml::Table = toml::from_str(include_str!("../../configs/eval/table1.toml")).unwrap();
    let world: toml::Table = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
    table.insert("world".into(), world.into());
    let mut config: EvalConfig = table.try_into().unwrap();
    (config.world.camera.width, config.world.camera.height) = (64, 48);
    config.sessions = count;
    config.obstacles.count = [1, 1];
    config.validate().unwrap();
    let environment = Environment::new(&config.world).unwrap();
    let policies = Policies { approach: &Oracle, avoid: &Oracle };
    run_sessions(&environment, &config, policies, &|_| (), &AtomicBool::new(false)).unwrap()
}
