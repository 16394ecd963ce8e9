//! The step-by-step scheduler: all points of the lattice, one motion at a time.
//!
//! A sub-step of the arm applies the rules in their order: the points that links hold stick, slip or are released; then
//! free points that a link now covers enter, each at its deepest link. The cost of a motion depends on the contacts and
//! the area of the links, not on the size of the lattice: the broad phase finds the free points that a link may have
//! reached.

use std::sync::Arc;

use nalgebra::Isometry3;

use super::broad_phase::{BroadPhase, Entered, Query};
use super::posed_link::{PosedLink, travel_m};
use super::rules::{ContactRules, HeldPoint, deepest_first};
use super::{ContactConfig, Contacts, LinkContacts, substeps};
use crate::lattice::{CellSet, Lattice};
use crate::robot::LinkId;
use crate::sdf::DistanceGrid;
use crate::setting::SettingError;

/// Moves the arm through the lattice and keeps its contacts.
///
/// Deterministic: the same poses give the same contacts.
#[derive(Debug, Clone)]
pub struct ContactSimulator {
    lattice: Lattice,
    surfaces: Arc<Vec<Option<DistanceGrid>>>,
    /// Largest motion of a point of the arm in one sub-step, m.
    substep_m: f64,
    rules: ContactRules,
    state: ContactState,
    /// Broad phase of each link.
    broad_phases: Vec<BroadPhase>,
    /// Reused memory for [`ContactRules::move_held_points`].
    lists: [Vec<u32>; 2],
}

/// Poses of the links at one moment, and the points that they hold.
#[derive(Debug, Clone)]
pub(crate) struct ContactState {
    /// Poses by link; none before the first touch.
    pub(crate) poses: Vec<Isometry3<f64>>,
    /// Points held, by link.
    pub(super) held: Vec<Vec<HeldPoint>>,
    /// Places that are held or known empty, and cannot be entered.
    pub(super) taken: CellSet,
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
        config: &ContactConfig,
    ) -> Result<Self, SettingError> {
        config.check()?;
        let held = vec![Vec::new(); surfaces.len()];
        Ok(Self {
            substep_m: config.substep_cells * lattice.spacing_m(),
            rules: ContactRules::new(config),
            state: ContactState { poses: Vec::new(), held, taken: CellSet::default() },
            broad_phases: vec![BroadPhase::default(); surfaces.len()],
            lists: Default::default(),
            lattice,
            surfaces,
        })
    }

    /// Forgets all contacts and starts a touch with the arm at these poses.
    ///
    /// With [`ContactConfig::known_empty`], the points that the links cover here are empty space for the whole touch.
    /// Without it, they are touched at once.
    ///
    /// # Panics
    ///
    /// If there is not one pose for each link, which is a bug in the caller.
    pub fn begin_touch(&mut self, world_from_link: &[Isometry3<f64>]) {
        assert_eq!(world_from_link.len(), self.surfaces.len(), "one pose per link");
        self.state.taken.clear();
        self.state.held.iter_mut().for_each(Vec::clear);
        self.broad_phases.iter_mut().for_each(BroadPhase::clear);
        self.state.poses = world_from_link.to_vec();
        let entered = self.find_entered(&[]);
        if self.rules.known_empty {
            entered.iter().for_each(|found| self.state.taken.insert(found.place));
        } else {
            self.hold(&entered);
        }
    }

    /// The present poses and contacts.
    pub(crate) fn state(&self) -> &ContactState {
        &self.state
    }

    /// Poses of the links; none before the first touch.
    pub fn poses(&self) -> &[Isometry3<f64>] {
        &self.state.poses
    }

    /// Number of sub-steps of a short motion, such that no point of a link moves farther than
    /// [`ContactConfig::substep_cells`] in one of them; at least 1.
    ///
    /// The motion must be so short that chord and arc are nearly equal.
    pub fn substeps(&self, from: &[Isometry3<f64>], to: &[Isometry3<f64>]) -> u32 {
        substeps(travel_m(&self.surfaces, from, to), self.substep_m)
    }

    /// Largest motion of a point of the arm in one sub-step, m.
    pub(crate) fn substep_m(&self) -> f64 {
        self.substep_m
    }

    /// Moves the arm to these poses and returns the contacts there.
    ///
    /// The motion is one sub-step: see [`ContactSimulator::substeps`] for its largest length.
    ///
    /// # Panics
    ///
    /// If no touch was begun, or there is not one pose for each link: bugs in the caller.
    pub fn advance(&mut self, world_from_link: &[Isometry3<f64>]) -> Contacts {
        self.move_to(world_from_link);
        self.contacts()
    }

    /// [`ContactSimulator::advance`] without a list of the contacts, for poses between two samples.
    pub(crate) fn move_to(&mut self, world_from_link: &[Isometry3<f64>]) {
        let poses = &self.state.poses;
        assert_eq!(world_from_link.len(), poses.len(), "one pose per link, after begin_touch");
        if world_from_link != poses {
            let mut released = Vec::new();
            for (link, pose) in world_from_link.iter().enumerate() {
                self.move_held_points(link, pose, &mut released);
            }
            self.move_links(world_from_link);
            let entered = self.find_entered(&released);
            self.hold(&entered);
        }
    }

    /// Applies stick, slip, rub and release to the points of one link; adds the places of released ones to
    /// `released`.
    fn move_held_points(
        &mut self,
        link: usize,
        world_from_link: &Isometry3<f64>,
        released: &mut Vec<[u32; 3]>,
    ) {
        let Some(surface) = &self.surfaces[link] else { return };
        let held = &mut self.state.held[link];
        let placed = PosedLink::new(world_from_link);
        self.rules.move_held_points(surface, &placed, (held, &mut self.lists));
        let Some(first) = held.iter().position(|point| !point.held) else { return };
        for point in held.extract_if(first.., |point| !point.held) {
            let place = self.lattice.place(point.cell);
            self.state.taken.remove(place);
            released.push(place);
        }
    }

    /// Moves the links to their new poses.
    fn move_links(&mut self, world_from_link: &[Isometry3<f64>]) {
        for (link, broad_phase) in self.broad_phases.iter_mut().enumerate() {
            if let Some(surface) = &self.surfaces[link] {
                let (from, to) = (&self.state.poses[link], &world_from_link[link]);
                broad_phase.travel(surface, self.rules.contact_distance_m, from, to);
            }
        }
        self.state.poses.clone_from_slice(world_from_link);
    }

    /// Free points that enter where the links are, each once, at its deepest link, in the lattice's
    /// order; `released` are places that have become free since the last call.
    fn find_entered(&mut self, released: &[[u32; 3]]) -> Vec<Entered> {
        let mut found = Vec::new();
        for (link, broad_phase) in self.broad_phases.iter_mut().enumerate() {
            let Some(surface) = &self.surfaces[link] else { continue };
            let query = Query {
                lattice: &self.lattice,
                taken: &self.state.taken,
                rules: &self.rules,
                link,
                surface,
                placed: PosedLink::new(&self.state.poses[link]),
            };
            broad_phase.find(&query, &mut found);
            for place in released {
                broad_phase.find_at(&query, *place, &mut found);
            }
        }
        found.sort_by(|a, b| {
            let place = |entered: &Entered| [entered.place[2], entered.place[1], entered.place[0]];
            let depth = |entered: &Entered| (entered.distance_m, entered.link);
            place(a).cmp(&place(b)).then(deepest_first(depth(a), depth(b)))
        });
        found.dedup_by_key(|entered| entered.place);
        found
    }

    /// Anchors newly entered points on the inflated surface of their links.
    fn hold(&mut self, entered: &[Entered]) {
        for found in entered {
            let Some(surface) = &self.surfaces[found.link] else { continue };
            let (cell, rest) = (self.lattice.cell(found.place), self.lattice.point_at(found.place));
            let pose = &self.state.poses[found.link];
            let point = HeldPoint::new(cell, rest, surface, pose, &self.rules);
            self.state.held[found.link].push(point);
            self.state.taken.insert(found.place);
        }
    }

    /// The present contacts, as [`ContactSimulator::advance`] returned them.
    pub fn contacts(&self) -> Contacts {
        let mut contacts = Contacts::default();
        for (link, held) in self.state.held.iter().enumerate() {
            if !held.is_empty() {
                contacts.links.push(LinkContacts {
                    link: LinkId(link as u16),
                    cells: held.iter().map(|point| point.cell).collect(),
                    displacements_m: held.iter().map(|point| point.displacement_m).collect(),
                });
            }
        }
        contacts
    }
}
