//! Which free points a link has come to cover, without looking where it cannot have.
//!
//! Every link keeps a [`Watch`]. What a motion costs follows the link's surface and how far it went,
//! never the lattice, and what is found is the same as if every point had been looked at. Where all
//! points are followed, that is an [`Agenda`] of blocks of them; where few are, a [`Roster`].

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};

use super::agenda::Agenda;
use super::chosen::{Chosen, Share};
use super::roster::Roster;
use crate::lattice::{BRICK_EDGE, CellSet, Lattice};
use crate::sdf::Grid;

/// A free point inside an inflated link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entered {
    pub(super) place: [u32; 3],
    pub(super) link: usize,
    pub(super) distance_m: f64,
}

/// How much more than a distance the baked φ may change between two points, as a factor:
/// trilinear interpolation of a distance is not quite 1-Lipschitz.
pub(super) const LIPSCHITZ: f64 = 1.1;

/// The box of a link's surface, as eight points of its frame.
pub(super) fn corners(surface: &Grid) -> [Point3<f64>; 8] {
    let (low, high) = surface.bounds();
    std::array::from_fn(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
        Point3::new(pick(0), pick(1), pick(2))
    })
}

/// What a look needs to know besides the watch.
pub(super) struct Look<'a> {
    pub(super) lattice: &'a Lattice,
    /// Places that cannot be entered.
    pub(super) taken: &'a CellSet,
    /// Those that can, if not all others.
    pub(super) chosen: Option<&'a Chosen>,
    /// Those that are looked at at all.
    pub(super) share: Share,
    /// δ.
    pub(super) reach_m: f64,
    /// How far a link may travel before its watch is written anew; what it reaches later is left out.
    pub(super) horizon_m: f64,
    pub(super) link: usize,
    pub(super) surface: &'a Grid,
    pub(super) pose: &'a Isometry3<f64>,
    /// The pose's rotation as a matrix, which turns points faster.
    pub(super) rotation: Rotation3<f64>,
}

/// What one link may come to cover.
#[derive(Debug, Clone, Default)]
pub(super) struct Watch {
    /// Whether it was written since the last touch began.
    written: bool,
    /// How far, at most, any point within reach has moved in the link's frame since then, or since
    /// it was written anew.
    travel_m: f64,
    /// If all points are followed.
    agenda: Agenda,
    /// If few are.
    roster: Roster,
}

impl Watch {
    /// Forgets everything: the next look is at all that is near.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Adds a motion of the link to its travel.
    ///
    /// In the link's frame a point x moves to `x' = M x` with `M = to⁻¹ from`; within a ball about
    /// the middle c of the link's box no point moves further than `|M c − c| + 2 sin(θ/2) ρ`. Only
    /// points within [`Look::within_m`] of the box are asked for, and so in such a ball: one from
    /// outside comes nearer by at most `|M c − c|` a motion.
    pub(super) fn travel(
        &mut self,
        surface: &Grid,
        within_m: f64,
        from: &Isometry3<f64>,
        to: &Isometry3<f64>,
    ) {
        let (low, high) = surface.bounds();
        let (middle, half) = (nalgebra::center(&low, &high), (high - low) / 2.0);
        let motion = to.inv_mul(from);
        let chord = 2.0 * motion.rotation.imag().norm();
        let radius_m = half.norm() + within_m;
        self.travel_m += (motion * middle - middle).norm() + chord * radius_m;
    }

    /// Adds the free points with φ < δ that the link has come to cover to `found`.
    pub(super) fn look(&mut self, look: &Look<'_>, found: &mut Vec<Entered>) {
        if !self.written || self.travel_m >= look.horizon_m {
            (self.written, self.travel_m) = (true, 0.0);
            match look.chosen {
                None => self.agenda.write(look, found),
                Some(chosen) => self.roster.write(look, chosen, found),
            }
        } else {
            match look.chosen {
                None => self.agenda.look(look, self.travel_m, found),
                Some(_) => self.roster.look(look, self.travel_m, found),
            }
        }
    }

    /// Looks at a place that has become free, now if the link covers it, or in time.
    pub(super) fn look_at(&mut self, look: &Look<'_>, place: [u32; 3], found: &mut Vec<Entered>) {
        match look.chosen {
            None => self.agenda.look_at(look, place, found),
            Some(_) => self.roster.look_at(look, place, self.travel_m, found),
        }
    }
}

impl Look<'_> {
    /// Whether a place is one of the lattice's.
    pub(super) fn is_inside(&self, place: [u32; 3]) -> bool {
        let shape = self.lattice.shape();
        (0..3).all(|axis| place[axis] < shape[axis])
    }

    /// A point in the link's frame.
    pub(super) fn in_link(&self, point: &Point3<f64>) -> Point3<f64> {
        let from_origin = point.coords - self.pose.translation.vector;
        Point3::from(self.rotation.matrix().tr_mul(&from_origin))
    }

    /// The middle of the box of the link's surface, in the link's frame.
    pub(super) fn middle(&self) -> Point3<f64> {
        let (low, high) = self.surface.bounds();
        nalgebra::center(&low, &high)
    }

    /// How far a point is from the box of the link's surface, in the link's frame, m.
    pub(super) fn box_distance_m(&self, point_link: &Point3<f64>) -> f64 {
        let (low, high) = self.surface.bounds();
        let outside = (low - point_link).sup(&(point_link - high)).sup(&Vector3::zeros());
        outside.norm()
    }

    /// The farthest from the link's box that a point may be to be watched.
    pub(super) fn within_m(&self) -> f64 {
        self.reach_m + LIPSCHITZ * self.horizon_m
    }

    /// The bricks, by their first places, that the link can reach within a horizon and that belong
    /// to the share.
    pub(super) fn bricks_near(&self) -> impl Iterator<Item = [u32; 3]> {
        let (first, end) = self.places_near();
        let share = self.share;
        let bricks = |axis: usize| match first[axis] < end[axis] {
            true => first[axis] / BRICK_EDGE..end[axis].div_ceil(BRICK_EDGE),
            false => 0..0,
        };
        let [x, y, z] = [0, 1, 2].map(bricks);
        let columns = z.flat_map(move |k| y.clone().map(move |j| [j, k]));
        let places = columns.flat_map(move |[j, k]| x.clone().map(move |i| [i, j, k]));
        places.map(|brick| brick.map(|n| n * BRICK_EDGE)).filter(move |low| share.holds(*low))
    }

    /// Whether any point of a brick may be that near to the link's box; `low` is its first place.
    pub(super) fn is_brick_within(&self, limit_m: f64, low: [u32; 3]) -> bool {
        let half_m = f64::from(BRICK_EDGE - 1) / 2.0 * self.lattice.spacing_m();
        let middle = self.lattice.point_at(low) + Vector3::repeat(half_m);
        self.box_distance_m(&self.in_link(&middle)) <= limit_m + half_m * 3f64.sqrt()
    }

    /// The places that the link's box reaches within a horizon.
    fn places_near(&self) -> ([u32; 3], [u32; 3]) {
        let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
        let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
        for corner in corners(self.surface) {
            let corner = self.pose * corner;
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        let reach = Vector3::repeat(self.within_m());
        self.lattice.places_within(&(low - reach), &(high + reach))
    }
}

/// Keeps every place once, with the link that covers it deepest, in the lattice's order.
pub(super) fn keep_deepest(found: &mut Vec<Entered>) {
    found.sort_by(|a, b| {
        let key = |entered: &Entered| [entered.place[2], entered.place[1], entered.place[0]];
        key(a).cmp(&key(b)).then(a.distance_m.total_cmp(&b.distance_m)).then(a.link.cmp(&b.link))
    });
    found.dedup_by_key(|entered| entered.place);
}
