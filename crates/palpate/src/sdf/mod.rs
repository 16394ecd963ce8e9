//! How far a point is from a link, and which way is out.
//!
//! The shapes of a link are *baked* once into a [`DistanceGrid`]: signed distances at the nodes of a
//! regular lattice in the link frame, negative inside, read back by trilinear interpolation in
//! some ten nanoseconds. Everything downstream asks a grid; nobody asks a mesh.
//!
//! | file        | says                                                            |
//! |-------------|-----------------------------------------------------------------|
//! | `grid`      | distance and normal from baked nodes                            |
//! | `bytes`     | the same to and from cache bytes                                |
//! | `primitive` | exact distance of box, cylinder, sphere and capsule             |
//! | `mesh`      | triangles, made fit to be asked; their closest point            |
//! | `winding`   | generalised winding number: inside or outside an open shell     |
//! | `flood`     | what the outside can reach                                      |
//! | `bake`      | all of it together, node by node                                |
//!
//! The frame of everything here is the link's; nothing moves. No file is opened: meshes come in
//! as triangles, caches as bytes.

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
pub use mesh::TriangleMesh;
pub use primitive::signed_distance;

/// Changes whenever the same shapes bake to other numbers: part of every cache key.
pub const BAKE_VERSION: u32 = 2;

/// What can be wrong with shapes, or with the bytes of a baked one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum SdfError {
    /// Nothing to bake.
    #[error("the shape is empty: found {triangles} triangles, none of them with an area")]
    Empty { triangles: usize },
    /// A triangle of vertices that do not exist.
    #[error("triangle {triangle} refers to vertex {vertex}, the mesh has {vertices}")]
    Vertex { triangle: usize, vertex: u32, vertices: usize },
    /// A number that no shape can have.
    #[error("{thing} is {found}, wanted {wanted}")]
    Number { thing: &'static str, found: f64, wanted: &'static str },
    /// More nodes than any link needs: in practice, millimetres taken for metres.
    #[error(
        "the shape spans {:.4} x {:.4} x {:.4} m, too large for a grid of {spacing_m} m; are its \
         coordinates in millimetres? then give the mesh a scale of 0.001", span_m[0], span_m[1], span_m[2]
    )]
    TooLarge { span_m: [f64; 3], spacing_m: f64 },
    /// Bytes that are not a grid, or not one any more.
    #[error("not a baked grid: {reason}")]
    Bytes { reason: &'static str },
}
