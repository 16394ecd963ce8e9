//! One layer of settings over another: what the upper has not, the lower gives.

use super::Settings;
use super::sections::{
    ContactSettings, EstimatorSettings, LatticeSettings, LogSettings, RobotSettings, TouchSettings,
};

impl Settings {
    /// These settings, and those of `lower` wherever these say nothing.
    pub fn over(self, lower: Self) -> Self {
        Self {
            robot: self.robot.over(lower.robot),
            log: self.log.over(lower.log),
            touch: self.touch.over(lower.touch),
            lattice: self.lattice.over(lower.lattice),
            contact: self.contact.over(lower.contact),
            estimator: self.estimator.over(lower.estimator),
        }
    }
}

impl RobotSettings {
    fn over(self, lower: Self) -> Self {
        Self {
            robot: self.robot.or(lower.robot),
            package_path: self.package_path.or(lower.package_path),
            cache_dir: self.cache_dir.or(lower.cache_dir),
            no_cache: self.no_cache.or(lower.no_cache),
            bake_spacing_m: self.bake_spacing_m.or(lower.bake_spacing_m),
            payload_link: self.payload_link.or(lower.payload_link),
            payload_mass_kg: self.payload_mass_kg.or(lower.payload_mass_kg),
            payload_com_m: self.payload_com_m.or(lower.payload_com_m),
        }
    }
}

impl LogSettings {
    fn over(self, lower: Self) -> Self {
        Self {
            angle_unit: self.angle_unit.or(lower.angle_unit),
            columns: self.columns.or(lower.columns),
            topic: self.topic.or(lower.topic),
            touch_topic: self.touch_topic.or(lower.touch_topic),
            joints: self.joints.or(lower.joints),
            until_break: self.until_break.or(lower.until_break),
            split_gap_s: self.split_gap_s.or(lower.split_gap_s),
            split_idle: self.split_idle.or(lower.split_idle),
            idle_s: self.idle_s.or(lower.idle_s),
        }
    }
}

impl TouchSettings {
    fn over(self, lower: Self) -> Self {
        // Frames given above turn off a `no_tare` below, and a `no_tare` above the frames below;
        // that there is a tare after all says nothing of its frames.
        let by_frames = self.tare_frames.is_some();
        let no_tare = self.no_tare == Some(true);
        Self {
            tare_frames: self.tare_frames.or(lower.tare_frames.filter(|_| !no_tare)),
            no_tare: self.no_tare.or(lower.no_tare.filter(|_| !by_frames)),
            torque_sign: self.torque_sign.or(lower.torque_sign),
            gravity: self.gravity.or(lower.gravity),
            still_rad: self.still_rad.or(lower.still_rad),
        }
    }
}

impl LatticeSettings {
    fn over(self, lower: Self) -> Self {
        // A box given above replaces an origin and shape below, and the other way round.
        let by_box = self.box_low_m.is_some() || self.box_high_m.is_some();
        let by_shape = self.origin_m.is_some() || self.shape.is_some();
        let unless = |given: bool| move |_: &[f64; 3]| !given;
        Self {
            spacing_m: self.spacing_m.or(lower.spacing_m),
            box_low_m: self.box_low_m.or(lower.box_low_m.filter(unless(by_shape))),
            box_high_m: self.box_high_m.or(lower.box_high_m.filter(unless(by_shape))),
            origin_m: self.origin_m.or(lower.origin_m.filter(unless(by_box))),
            shape: self.shape.or(lower.shape.filter(|_| !by_box)),
        }
    }
}

impl ContactSettings {
    fn over(self, lower: Self) -> Self {
        Self {
            contact_distance_m: self.contact_distance_m.or(lower.contact_distance_m),
            friction: self.friction.or(lower.friction),
            slip_step_m: self.slip_step_m.or(lower.slip_step_m),
            slip_iterations: self.slip_iterations.or(lower.slip_iterations),
            substep_cells: self.substep_cells.or(lower.substep_cells),
            known_empty: self.known_empty.or(lower.known_empty),
        }
    }
}

impl EstimatorSettings {
    fn over(self, lower: Self) -> Self {
        Self {
            estimator: self.estimator.or(lower.estimator),
            prior_mean: self.prior_mean.or(lower.prior_mean),
            prior_std: self.prior_std.or(lower.prior_std),
            torque_std: self.torque_std.or(lower.torque_std),
            drift_std: self.drift_std.or(lower.drift_std),
            replays: self.replays.or(lower.replays),
            memory_frames: self.memory_frames.or(lower.memory_frames),
            memory_mib: self.memory_mib.or(lower.memory_mib),
            seed: self.seed.or(lower.seed),
        }
    }
}
