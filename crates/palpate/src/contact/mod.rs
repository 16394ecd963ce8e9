//! Where the arm pushes the points of the field, and by how much (Sec. II, assumption ii).
//!
//! | paper | here                        | value                            | unit |
//! |-------|-----------------------------|----------------------------------|------|
//! | W_c   | [`Contacts`]                | cells that the arm displaces now |      |
//! | uᵢ    | [`LinkContacts::displacements_m`] | anchor − rest point, world | m    |
//! | δ     | [`ContactConfig::contact_distance_m`] | inflation of the links    | m |
//! | μ     | [`ContactConfig::friction`]        | cone of sticking                 | –    |
//! | λ     | [`ContactConfig::slip_step_m`] | longest slip of one iteration    | m |
//!
//! Contacts follow from the arm's motion alone: no torque and no stiffness comes in here, so a
//! motion has the same contacts whether it is being learnt from or asked about. Every link is
//! its signed distance φ, inflated by δ. One motion of the arm goes through three verbs:
//!
//! - *carry*: the anchor of a touched point moves with its link (stick);
//! - *stick_and_slip*: it slips along the surface while the friction cone is violated, and lets go when
//!   the spring would have to pull (`stick_and_slip.rs`);
//! - *enter*: free points that the inflated link now covers get an anchor (`enter.rs`).
//!
//! The cost follows the contacts and the links' surfaces, not the lattice's size. A [`ContactSimulator`]
//! takes all points through one motion after the other, since it does not know the next. Where a
//! whole way is known beforehand (`trajectory.rs`), a path_simulator of points is followed alone (`path_simulator.rs`).

mod broad_phase;
mod enter;
mod path_simulator;
mod placed;
mod posed_trajectory;
mod stick_slip;

use std::sync::Arc;

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

pub(crate) use path_simulator::{Displaced, PathContactSimulator};
pub(crate) use placed::travel_m;
pub(crate) use posed_trajectory::PosedTrajectory;

use placed::Placed;

use crate::lattice::{CellId, CellSet, Lattice};
use crate::robot::LinkId;
use crate::sdf::DistanceGrid;
use crate::setting::SettingError;

/// How the arm's links meet the points of the field.
///
/// δ and λ are lengths of the world, not of the lattice: a δ of 2 to 3 cm did best at every
/// resolution tried, from 0.9 to 2 cm, on simulated plants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactConfig {
    /// δ: how far from its surface a link takes hold of a point.
    pub contact_distance_m: f64,
    /// μ: tangential over normal displacement at which a point begins to slip.
    pub friction: f64,
    /// λ: the farthest that a point slips in one iteration.
    pub slip_step_m: f64,
    /// Slip iterations of one motion; 0 makes points stick for good.
    pub slip_iterations: u32,
    /// The farthest that a point of a link travels in one sub-step, in cells.
    pub substep_cells: f64,
    /// Whether points inside the links at the start of a touch are empty space throughout it.
    pub known_empty: bool,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            contact_distance_m: 0.024,
            friction: 0.3,
            slip_step_m: 0.006,
            slip_iterations: 10,
            substep_cells: 0.5,
            known_empty: true,
        }
    }
}

/// Distances are baked as far as this from the links.
const BAKED: &str = "from 1e-6 to 0.04 m, as far as distances are baked";

impl ContactConfig {
    /// Checks every setting.
    ///
    /// # Errors
    ///
    /// Names the first setting that is not a finite number in its range.
    pub fn check(&self) -> Result<(), SettingError> {
        let positive = [
            ("contact_distance_m", self.contact_distance_m, [1e-6, 0.04], BAKED),
            ("slip_step_m", self.slip_step_m, [1e-6, 1.0], "from 1e-6 to 1 m"),
            ("substep_cells", self.substep_cells, [0.01, 100.0], "from 0.01 to 100 cells"),
        ];
        for (setting, found, [low, high], wanted) in positive {
            if !(low..=high).contains(&found) {
                return Err(SettingError::new(setting, found, wanted));
            }
        }
        if !(self.friction >= 0.0 && self.friction.is_finite()) {
            let wanted = "zero or more, and finite";
            return Err(SettingError::new("friction", self.friction, wanted));
        }
        Ok(())
    }
}

/// The points that one link displaces, and by how much.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkContacts {
    /// The link that holds the points.
    pub link: LinkId,
    /// The points' cells, in the order in which they were touched.
    pub cells: Vec<CellId>,
    /// Their displacements in the same order: anchor − rest point, world frame, m.
    pub displacements_m: Vec<[f32; 3]>,
}

/// W_c and its displacements: what the arm touches now, link by link.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Contacts {
    /// Links that touch anything, in the order of their numbers.
    pub links: Vec<LinkContacts>,
}

impl Contacts {
    /// Points touched, over all links.
    pub fn len(&self) -> usize {
        self.links.iter().map(|link| link.cells.len()).sum()
    }

    /// Whether nothing is touched.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }
}

/// Follows the arm through the lattice and keeps what it displaces.
///
/// Deterministic: the same poses give the same contacts.
#[derive(Debug, Clone)]
pub struct ContactSimulator {
    lattice: Lattice,
    surfaces: Arc<Vec<Option<DistanceGrid>>>,
    config: ContactConfig,
    poses: Vec<Isometry3<f64>>,
    /// By link.
    touched: Vec<Vec<stick_slip::Touched>>,
    /// Room for [`stick_slip::stick_and_slip`].
    slipping: Vec<u32>,
    /// By link.
    broad_phases: Vec<broad_phase::BroadPhase>,
    /// Places that are touched or known empty, and cannot be entered.
    taken: CellSet,
}

/// How many sub-steps no longer than that a motion needs, at least 1; m.
pub(crate) fn substeps(travel_m: f64, substep_m: f64) -> u32 {
    ((travel_m / substep_m).ceil() as u32).max(1)
}

/// What the arm holds at one moment, for whoever goes on from there.
#[derive(Debug, Clone)]
pub(crate) struct ContactState {
    /// Where the links are, by link.
    pub(crate) poses: Vec<Isometry3<f64>>,
    /// By link.
    touched: Vec<Vec<stick_slip::Touched>>,
    /// Places that are touched or known empty, and cannot be entered.
    taken: CellSet,
}

impl ContactSimulator {
    /// A simulator for links with the given surfaces (index = [`LinkId`]; `None` = no shape).
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(
        lattice: Lattice,
        surfaces: Arc<Vec<Option<DistanceGrid>>>,
        config: ContactConfig,
    ) -> Result<Self, SettingError> {
        config.check()?;
        let touched = vec![Vec::new(); surfaces.len()];
        let broad_phases = vec![broad_phase::BroadPhase::default(); surfaces.len()];
        let (poses, slipping, taken) = (Vec::new(), Vec::new(), CellSet::default());
        Ok(Self { lattice, surfaces, config, poses, touched, slipping, broad_phases, taken })
    }

    /// Forgets all contacts and starts a touch with the arm at these poses.
    ///
    /// With [`ContactConfig::known_empty`], the points that the links cover here are empty space for the
    /// whole touch: the object, at rest, cannot be where the arm stands without touching it.
    /// Without, they are touched at once.
    ///
    /// # Panics
    ///
    /// If there is not one pose a link, which is a bug in the caller.
    pub fn begin_touch(&mut self, world_from_link: &[Isometry3<f64>]) {
        assert_eq!(world_from_link.len(), self.touched.len(), "one pose per link");
        self.taken.clear();
        self.touched.iter_mut().for_each(Vec::clear);
        self.broad_phases.iter_mut().for_each(broad_phase::BroadPhase::clear);
        self.poses = world_from_link.to_vec();
        let entered = self.find_entered(&[]);
        if self.config.known_empty {
            entered.iter().for_each(|found| self.taken.insert(found.place));
        } else {
            self.hold(&entered);
        }
    }

    /// What the arm holds where it is.
    pub(crate) fn contact_state(&self) -> ContactState {
        let (poses, touched) = (self.poses.clone(), self.touched.clone());
        ContactState { poses, touched, taken: self.taken.clone() }
    }

    /// Where the links are, by link; nowhere before the first touch.
    pub fn poses(&self) -> &[Isometry3<f64>] {
        &self.poses
    }

    /// How many sub-steps a short motion needs so that no point of a link goes further than
    /// [`ContactConfig::substep_cells`] in one; at least 1.
    ///
    /// The motion must be short enough for chord and arc to be alike.
    pub fn substeps(&self, from: &[Isometry3<f64>], to: &[Isometry3<f64>]) -> u32 {
        substeps(travel_m(&self.surfaces, from, to), self.substep_m())
    }

    /// The longest sub-step, m.
    pub(crate) fn substep_m(&self) -> f64 {
        self.config.substep_cells * self.lattice.spacing_m()
    }

    /// Moves the arm to these poses and returns what it displaces there.
    ///
    /// The motion is one sub-step: see [`ContactSimulator::substeps`] for how far it may reach.
    ///
    /// # Panics
    ///
    /// If no touch was begun, or there is not one pose a link: bugs in the caller.
    pub fn advance(&mut self, world_from_link: &[Isometry3<f64>]) -> Contacts {
        assert_eq!(world_from_link.len(), self.poses.len(), "one pose per link, after begin_touch");
        if world_from_link != self.poses {
            let mut released = Vec::new();
            for (link, pose) in world_from_link.iter().enumerate() {
                self.stick_and_slip_link(link, pose, &mut released);
            }
            self.move_links(world_from_link);
            let entered = self.find_entered(&released);
            self.hold(&entered);
        }
        self.contacts()
    }

    /// Carries, slips and releases the points that one link holds; `released` gets the places of
    /// those it let go.
    fn stick_and_slip_link(
        &mut self,
        link: usize,
        world_from_link: &Isometry3<f64>,
        released: &mut Vec<[u32; 3]>,
    ) {
        let Some(surface) = &self.surfaces[link] else { return };
        let slip = stick_slip::Slip::new(&self.config);
        let touched = &mut self.touched[link];
        let placed = Placed::new(world_from_link);
        stick_slip::stick_and_slip(surface, &placed, &slip, (&mut *touched, &mut self.slipping));
        let first = released.len();
        let let_go = touched.iter().filter(|touched| !touched.held);
        released.extend(let_go.map(|touched| self.lattice.place(touched.cell)));
        if released.len() > first {
            touched.retain(|touched| touched.held);
            released[first..].iter().for_each(|place| self.taken.remove(*place));
        }
    }

    /// Takes the links to their new poses.
    fn move_links(&mut self, world_from_link: &[Isometry3<f64>]) {
        for (link, broad_phase) in self.broad_phases.iter_mut().enumerate() {
            if let Some(surface) = &self.surfaces[link] {
                let (from, to) = (&self.poses[link], &world_from_link[link]);
                broad_phase.travel(surface, self.config.contact_distance_m, from, to);
            }
        }
        self.poses.clone_from_slice(world_from_link);
    }

    /// Free points that the links cover where they are, each once, with its deepest link;
    /// `released` are places that have become free since the last query.
    fn find_entered(&mut self, released: &[[u32; 3]]) -> Vec<enter::Entered> {
        let mut found = Vec::new();
        for (link, broad_phase) in self.broad_phases.iter_mut().enumerate() {
            let Some(surface) = &self.surfaces[link] else { continue };
            let query = enter::Query {
                lattice: &self.lattice,
                taken: &self.taken,
                reach_m: self.config.contact_distance_m,
                link,
                surface,
                placed: Placed::new(&self.poses[link]),
            };
            broad_phase.look(&query, &mut found);
            for place in released {
                broad_phase.look_at(&query, *place, &mut found);
            }
        }
        enter::keep_deepest(&mut found);
        found
    }

    /// Anchors newly entered points on the inflated surface of their links.
    fn hold(&mut self, entered: &[enter::Entered]) {
        let slip = stick_slip::Slip::new(&self.config);
        for found in entered {
            let Some(surface) = &self.surfaces[found.link] else { continue };
            let (cell, rest) = (self.lattice.cell(found.place), self.lattice.point_at(found.place));
            let pose = &self.poses[found.link];
            let touched = stick_slip::Touched::new(cell, rest, surface, pose, &slip);
            self.touched[found.link].push(touched);
            self.taken.insert(found.place);
        }
    }

    /// The contacts as they stand; those of [`ContactSimulator::advance`], without a motion.
    pub fn contacts(&self) -> Contacts {
        let mut contacts = Contacts::default();
        for (link, touched) in self.touched.iter().enumerate() {
            if !touched.is_empty() {
                contacts.links.push(LinkContacts {
                    link: LinkId(link as u16),
                    cells: touched.iter().map(|touched| touched.cell).collect(),
                    displacements_m: touched.iter().map(|touched| touched.displacement_m).collect(),
                });
            }
        }
        contacts
    }
}
