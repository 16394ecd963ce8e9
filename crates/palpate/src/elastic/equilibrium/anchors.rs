//! Anchors: the places on links where points of the body stick, and how they slip.

use nalgebra::{Point3, Vector3};

use super::Equilibrium;
use crate::elastic::contact::{Anchor, PlacedLink, deepest};
use crate::elastic::pose::Pose;

impl Equilibrium {
    /// Offset of a point from its anchor on a link, m, and its last normal force, N.
    pub(super) fn offset(
        &self,
        point: usize,
        placed: &[PlacedLink<'_>],
        link: usize,
        at: &Point3<f64>,
    ) -> (Vector3<f64>, f64) {
        match &self.state.anchors[point] {
            Some(anchor) if anchor.link == placed[link].index => {
                (at - placed[link].world_from_link * anchor.place_link, anchor.pressed_n)
            }
            _ => (Vector3::zeros(), 0.0),
        }
    }

    /// Updates which points touch a link, and their normal forces.
    pub(super) fn update_anchors(
        &mut self,
        placed: &[PlacedLink<'_>],
        near: &[Vec<u16>],
        posed: &Pose,
    ) {
        for index in 0..self.points.len() {
            let point = self.points[index];
            if near[point.segment].is_empty() || self.state.ignored[index] {
                self.state.anchors[index] = None;
                continue;
            }
            let at = posed.point(point.segment, &point.lever_m);
            let pressed = deepest(placed, &near[point.segment], &at, point.radius_m);
            self.state.anchors[index] = pressed.map(|pressed| {
                let link = &placed[pressed.link];
                let pressed_n = self.config.stiffness_n_per_m * pressed.depth_m;
                match self.state.anchors[index].filter(|anchor| anchor.link == link.index) {
                    Some(anchor) => Anchor { pressed_n, ..anchor },
                    None => {
                        let place_link = link.link_from_world * at;
                        Anchor { link: link.index, place_link, pressed_n }
                    }
                }
            });
        }
    }

    /// Moves the anchors of points that slip or creep, so that the offsets stay within the friction cone.
    pub(super) fn slide_anchors(&mut self, placed: &[PlacedLink<'_>], near: &[Vec<u16>]) {
        let posed = self.posed();
        self.update_anchors(placed, near, &posed);
        let inverse_effective_masses = self.body.inverse_effective_masses();
        for (index, point) in self.points.iter().enumerate() {
            let Some(anchor) = &mut self.state.anchors[index] else { continue };
            let Some(link) = placed.iter().find(|link| link.index == anchor.link) else { continue };
            let at = posed.point(point.segment, &point.lever_m);
            let (_, slope) = link.grid.smooth_distance_and_slope(&(link.link_from_world * at));
            let normal = link.world_from_link.rotation * slope;
            let normal = normal.try_normalize(1e-9).unwrap_or(Vector3::z());
            let offset = at - link.world_from_link * anchor.place_link;
            let slip = offset - normal * normal.dot(&offset);
            let slip = slip
                / self
                    .config
                    .creep_softening(inverse_effective_masses[point.segment], self.substep_s);
            let longest = self.config.longest_slip_m(anchor.pressed_n);
            // Only the tangential offset is limited: along the normal, the anchor follows its point.
            let kept = if slip.norm() > longest { slip * (longest / slip.norm()) } else { slip };
            anchor.place_link = link.link_from_world * (at - kept);
        }
    }
}
