//! Grids as bytes, for a cache whose contents are checked.
//!
//! Little-endian, in this order: magic and version (8 bytes), nodes along x, y, z (3 × u32),
//! spacing, origin, lowest and highest corner of the surface (10 × f64), the nodes (f32, x
//! fastest), a checksum of all of it (u64). The length follows from the number of nodes, so a byte
//! more or less is an error; every change of a single byte changes the checksum; and the numbers
//! are checked for plausibility, so that wrong contents with a valid checksum are refused as well.

use nalgebra::Point3;

use super::{DistanceGrid, SdfError};

const MAGIC: [u8; 8] = *b"palpsdf\x01";
const HEADER_BYTES: usize = 8 + 3 * 4 + 10 * 8;
const CHECKSUM_BYTES: usize = 8;

impl DistanceGrid {
    /// The grid as bytes, the same on every machine.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.size_bytes() + CHECKSUM_BYTES);
        bytes.extend(MAGIC);
        for n in self.shape {
            let n = u32::try_from(n).expect("baking and reading both bound the nodes");
            bytes.extend(n.to_le_bytes());
        }
        let [low, high] = &self.surface;
        let points = [&self.origin_m, low, high];
        let numbers = points.into_iter().flat_map(|point| point.iter().copied());
        for number in std::iter::once(self.spacing_m).chain(numbers) {
            bytes.extend(number.to_le_bytes());
        }
        for node in &self.nodes_m {
            bytes.extend(node.to_le_bytes());
        }
        bytes.extend(checksum(bytes.iter().copied()).to_le_bytes());
        bytes
    }

    /// Reads what [`DistanceGrid::to_bytes`] wrote.
    ///
    /// # Errors
    ///
    /// [`SdfError::Bytes`] for anything else: the caller should bake again.
    pub fn from_bytes(bytes: &[u8]) -> Result<DistanceGrid, SdfError> {
        let refuse = |reason| SdfError::Bytes { reason };
        let (content, sum) =
            bytes.split_last_chunk::<CHECKSUM_BYTES>().ok_or(refuse("too short"))?;
        let (header, nodes) = content.split_at_checked(HEADER_BYTES).ok_or(refuse("too short"))?;
        let (magic, header) = header.split_at(8);
        if magic != MAGIC {
            return Err(refuse("wrong magic or version"));
        }
        let (counts, numbers) = header.split_at(12);
        let shape: Vec<usize> =
            counts.as_chunks().0.iter().map(|count| u32::from_le_bytes(*count) as usize).collect();
        let shape = [shape[0], shape[1], shape[2]];
        let length = shape.iter().try_fold(size_of::<f32>(), |length, &n| length.checked_mul(n));
        if length != Some(nodes.len()) || shape.iter().any(|&n| n < 2) {
            return Err(refuse("length does not fit the number of nodes"));
        }
        if checksum(content.iter().copied()) != u64::from_le_bytes(*sum) {
            return Err(refuse("checksum does not fit the content"));
        }

        let numbers: Vec<f64> =
            numbers.as_chunks().0.iter().map(|number| f64::from_le_bytes(*number)).collect();
        let point = |at: usize| Point3::new(numbers[at], numbers[at + 1], numbers[at + 2]);
        let nodes_m = nodes.as_chunks().0.iter().map(|node| f32::from_le_bytes(*node)).collect();
        let grid = DistanceGrid::new(point(1), numbers[0], shape, [point(4), point(7)], nodes_m);
        if grid.makes_sense() { Ok(grid) } else { Err(refuse("numbers out of range")) }
    }

    /// Whether the grid has what baking guarantees: finite numbers, the surface within the grid.
    fn makes_sense(&self) -> bool {
        let [low, high] = self.surface;
        let end = self.origin_m.coords + nalgebra::Vector3::from(self.last_cell) * self.spacing_m;
        self.spacing_m.is_finite()
            && self.spacing_m > 0.0
            && self.nodes_m.iter().all(|node| node.is_finite())
            && self.origin_m.iter().all(|number| number.is_finite())
            && (0..3).all(|axis| {
                self.origin_m[axis] < low[axis] && low[axis] < high[axis] && high[axis] < end[axis]
            })
    }
}

/// FNV-1a, 64 bits.
pub(crate) fn checksum(bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
