//! Signed distance of a point from a link, and the outward normal there.
//!
//! The shapes of a link are *baked* once into a [`DistanceGrid`]: signed distances at the nodes of a regular lattice in
//! the link frame, negative inside, read back by trilinear interpolation in some ten nanoseconds. Other modules use
//! grids only, never meshes.
//!
//! | file        | contents                                                        |
//! |-------------|-----------------------------------------------------------------|
//! | `grid`      | distance and normal from baked nodes                            |
//! | `bytes`     | grids to and from bytes, for a cache                            |
//! | `primitive` | exact distance of box, cylinder, sphere and capsule             |
//! | `mesh`      | triangles, cleaned for distance queries; their closest point    |
//! | `winding`   | generalised winding number: inside or outside an open shell     |
//! | `flood`     | nodes of a grid that the outside can reach                      |
//! | `bake`      | baking of all shapes of a link, node by node                    |
//!
//! All coordinates are in the frame of the link. No file is opened: meshes come in as triangles, caches as bytes.

mod bake;
mod bytes;
mod flood;
mod grid;
mod mesh;
mod primitive;
mod winding;

pub use bake::{BakeConfig, BakeReport, Solid, bake};
pub(crate) use bytes::checksum;
pub use grid::DistanceGrid;
pub(crate) use grid::LANES;
pub use mesh::TriangleMesh;
pub use primitive::signed_distance;

/// Increased whenever baking gives other numbers for the same shapes; part of every cache key.
pub const BAKE_VERSION: u32 = 2;

/// What can be wrong with shapes, or with the bytes of a baked one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum SdfError {
    /// No shapes, or only triangles without area.
    #[error("the shape is empty: found {triangles} triangles, none of them with an area")]
    Empty { triangles: usize },
    /// A triangle of vertices that do not exist.
    #[error("triangle {triangle} refers to vertex {vertex}, the mesh has {vertices}")]
    Vertex { triangle: usize, vertex: u32, vertices: usize },
    /// A number out of its range.
    #[error("{thing} is {found}, wanted {wanted}")]
    Number { thing: &'static str, found: f64, wanted: &'static str },
    /// More nodes than any link needs: in practice, millimetres taken for metres.
    #[error(
        "the shape spans {:.4} x {:.4} x {:.4} m, too large for a grid of {spacing_m} m; are its \
         coordinates in millimetres? then give the mesh a scale of 0.001", span_m[0], span_m[1], span_m[2]
    )]
    TooLarge { span_m: [f64; 3], spacing_m: f64 },
    /// Bytes that are not a grid, or a damaged one.
    #[error("not a baked grid: {reason}")]
    Bytes { reason: &'static str },
}
