//! Where the arm pushes the points of the field, and by how much (Sec. II, assumption ii).
//!
//! | paper | here                                  | value                            | unit |
//! |-------|---------------------------------------|----------------------------------|------|
//! | W_c   | [`Contacts`]                          | cells that the arm displaces now |      |
//! | uᵢ    | [`LinkContacts::displacements_m`]     | anchor − rest point, world frame | m    |
//! | δ     | [`ContactConfig::contact_distance_m`] | inflation of the links           | m    |
//! | μ     | [`ContactConfig::friction`]           | cone of sticking                 | –    |
//! |       | [`ContactConfig::coulomb_friction`]   | friction force over normal force | –    |
//! | λ     | [`ContactConfig::slip_step_m`]        | longest slip of one iteration    | m    |
//!
//! With Coulomb friction, uᵢ is the displacement whose spring exerts the force of contact and friction: only its part along
//! the normal is anchor − rest point.
//!
//! Contacts depend on the arm's motion alone, neither on torque nor on stiffness, so a motion has the same contacts in
//! learning and in prediction. Every link is represented by its signed distance φ, inflated by δ.
//!
//! | file                | contents                                                              |
//! |---------------------|-----------------------------------------------------------------------|
//! | `rules`             | enter, deepest link, known empty, stick, slip, rub, release           |
//! | `simulator`         | scheduler of all points, for one motion after the other               |
//! | `broad_phase`       | which free points a link may have reached                             |
//! | `path_simulator`    | scheduler of selected points along a known trajectory                 |
//! | `posed_trajectory`  | poses of a known trajectory, and when a link is near a point          |
//! | `posed_link`        | pose of a link, and how far it moves                                  |

mod broad_phase;
mod path_simulator;
mod posed_link;
mod posed_trajectory;
mod rules;
mod simulator;

use serde::{Deserialize, Serialize};

pub(crate) use path_simulator::{Displaced, PathContactSimulator};
pub(crate) use posed_link::travel_m;
pub(crate) use posed_trajectory::PosedTrajectory;
pub use simulator::ContactSimulator;
pub(crate) use simulator::ContactState;

use crate::lattice::CellId;
use crate::robot::LinkId;
use crate::setting::SettingError;

/// Settings of the contact model: how the arm's links meet the points of the field.
///
/// δ and λ are physical lengths, independent of the lattice: a δ of 2 to 3 cm gave the smallest errors at every spacing
/// tried, from 0.9 to 2 cm, on simulated plants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ContactConfig {
    /// δ: distance from the surface of a link at which a point enters contact.
    pub contact_distance_m: f64,
    /// μ: tangential over normal displacement at which a point begins to slip.
    pub friction: f64,
    /// Coefficient of Coulomb friction between link and object: tangential over normal force, against the tangential
    /// motion of the link. With 0, the tangential force is that of the point's spring.
    pub coulomb_friction: f64,
    /// λ: largest slip of a point in one iteration.
    pub slip_step_m: f64,
    /// Slip iterations of one sub-step. With 0, points never slip: they stick until they are released.
    pub slip_iterations: u32,
    /// Largest motion of a point of a link in one sub-step, in cells.
    pub substep_cells: f64,
    /// Whether points closer than δ to a link at the start of a touch count as empty space for the whole touch.
    pub known_empty: bool,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self {
            contact_distance_m: 0.024,
            friction: 0.3,
            coulomb_friction: 0.0,
            slip_step_m: 0.006,
            slip_iterations: 10,
            substep_cells: 0.5,
            known_empty: true,
        }
    }
}

/// Range of δ: distances are baked up to 0.04 m from the links.
const BAKED: &str = "from 1e-6 to 0.04 m, the range of the baked distances";

impl ContactConfig {
    /// Checks every setting.
    ///
    /// # Errors
    ///
    /// Names the first setting that is not a finite number in its range.
    pub fn check(&self) -> Result<(), SettingError> {
        let check = SettingError::check;
        check("contact_distance_m", self.contact_distance_m, 1e-6..=0.04, BAKED)?;
        check("slip_step_m", self.slip_step_m, 1e-6..=1.0, "from 1e-6 to 1 m")?;
        check("substep_cells", self.substep_cells, 0.01..=100.0, "from 0.01 to 100 cells")?;
        let (finite, wanted) = (0.0..=f64::MAX, "zero or more, and finite");
        check("friction", self.friction, finite.clone(), wanted)?;
        check("coulomb_friction", self.coulomb_friction, finite, wanted)
    }
}

/// The points that one link displaces, and by how much.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkContacts {
    /// The link that holds the points.
    pub link: LinkId,
    /// The points' cells, in the order in which they were touched.
    pub cells: Vec<CellId>,
    /// Their displacements in the same order: anchor − rest point, world frame, m. With
    /// [`ContactConfig::coulomb_friction`], its normal part plus the friction force divided by the stiffness.
    pub displacements_m: Vec<[f32; 3]>,
}

/// W_c and its displacements: the present contacts, link by link.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Contacts {
    /// Links with contacts, in the order of their numbers.
    pub links: Vec<LinkContacts>,
}

impl Contacts {
    /// Number of touched points, over all links.
    pub fn len(&self) -> usize {
        self.links.iter().map(|link| link.cells.len()).sum()
    }

    /// Whether nothing is touched.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }
}

/// Number of sub-steps of at most `substep_m` into which a motion of `travel_m` is cut; at least 1.
pub(crate) fn substeps(travel_m: f64, substep_m: f64) -> u32 {
    ((travel_m / substep_m).ceil() as u32).max(1)
}
