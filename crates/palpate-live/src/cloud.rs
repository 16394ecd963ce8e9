//! The contacts, and the field near them, as point clouds.

use nalgebra::Vector3;
use palpate::Mapper;

use crate::message::{Header, PointCloud2};

/// The published part of the field: the bounding box of the contacts, enlarged by this, m.
const NEAR_M: f64 = 0.15;

/// The present contacts: rest point (m), displacement (m), K and its standard deviation (N/m).
pub(crate) fn contacts(mapper: &Mapper, header: &Header) -> PointCloud2 {
    let lattice = &mapper.config().lattice;
    let mut points = Vec::new();
    for link in mapper.contacts().links {
        for (&cell, [ux, uy, uz]) in link.cells.iter().zip(link.displacements_m) {
            let [x, y, z] = lattice.point(cell).coords.map(|x| x as f32).into();
            let known = mapper.cell(cell);
            let (k, std) = (known.stiffness_n_per_m as f32, known.std_n_per_m as f32);
            points.push([x, y, z, ux, uy, uz, k, std]);
        }
    }
    let names = ["x", "y", "z", "ux", "uy", "uz", "stiffness", "stiffness_std"];
    PointCloud2::of(header.clone(), names, &points)
}

/// The field near the present contacts: rest point (m), K and its standard deviation (N/m), and the
/// number of frames that touched the cell; `None` without contact.
pub(crate) fn field_near_contacts(mapper: &Mapper, header: &Header) -> Option<PointCloud2> {
    let lattice = &mapper.config().lattice;
    let links = mapper.contacts().links;
    let touched = links.iter().flat_map(|link| &link.cells).map(|cell| lattice.point(*cell));
    let (low, high) = touched
        .map(|point| (point, point))
        .reduce(|(low, high), (point, _)| (low.inf(&point), high.sup(&point)))?;
    let near = Vector3::repeat(NEAR_M);
    let (low, high) = (low - near, high + near);
    let field = mapper.field();
    let known = field.stiffness_n_per_m.iter().zip(&field.std_n_per_m).zip(&field.counts);
    let points: Vec<[f32; 6]> = field
        .cells
        .iter()
        .zip(known)
        .filter_map(|(cell, ((k, std), count))| {
            let point = lattice.point(*cell);
            (low <= point && point <= high).then(|| {
                let [x, y, z] = point.coords.map(|x| x as f32).into();
                [x, y, z, *k as f32, *std as f32, *count as f32]
            })
        })
        .collect();
    let names = ["x", "y", "z", "stiffness", "stiffness_std", "count"];
    Some(PointCloud2::of(header.clone(), names, &points))
}
