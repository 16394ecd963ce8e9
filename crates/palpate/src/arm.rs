//! stub
use crate::{robot::Robot, sdf::Grid};
use std::sync::Arc;
#[derive(Debug, Clone)]
pub struct Arm {
    pub robot: Robot,
    pub surfaces: Arc<Vec<Option<Grid>>>,
}
impl Arm {
    pub fn fingerprint(&self) -> u64 {
        0
    }
}
