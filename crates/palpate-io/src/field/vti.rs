//! Writes a field as a VTK image (`.vti`) for ParaView: numbers at the points of a grid.
//!
//! The grid is the bounding box of the field's cells in the lattice. Grid points that are not cells
//! of the field have zeros; `N_obs` distinguishes them from soft points. The numbers follow the XML
//! as raw little-endian 32-bit floats, written one after another, so that memory grows with the
//! number of cells and not with the box.

use std::io::{self, Write};
use std::path::Path;

use palpate::{CellId, Lattice};

use super::file::FieldFile;
use crate::atomic::{self, WriteError};

/// Largest number of points of a grid, which viewers can open; a larger one is refused.
const MAX_POINTS: u64 = 1 << 31;

/// Writes the stiffness of a field, and its standard deviation and counts if it has them.
///
/// # Errors
///
/// [`WriteError`], also if the field has no lattice or no cells, or its box has more than 2³¹
/// points; the path is then unchanged.
pub fn write_vti(path: &Path, field: &FieldFile) -> Result<(), WriteError> {
    atomic::write(path, |out| fill(out, field))
}

fn fill(out: &mut impl Write, field: &FieldFile) -> io::Result<()> {
    let refused = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
    let (Some(lattice), Some(cells)) = (&field.lattice, &field.cells) else {
        let what = "the field has no lattice, which an image needs; write it as .ply";
        return Err(refused(what.to_owned()));
    };
    let lattice = Lattice::new(lattice.origin_m, lattice.spacing_m, lattice.shape)
        .map_err(|error| refused(error.to_string()))?;
    let places: Vec<[u32; 3]> = cells.iter().map(|&cell| lattice.place(CellId(cell))).collect();
    let low = span(&places, u32::MAX, u32::min);
    let high = span(&places, 0, u32::max);
    if places.is_empty() {
        return Err(refused("the field has no cell".to_owned()));
    }
    let sides: [u64; 3] = std::array::from_fn(|axis| u64::from(high[axis] - low[axis]) + 1);
    let points: u64 = sides.iter().product();
    if points > MAX_POINTS {
        return Err(refused(format!(
            "its cells span {points} points, an image may have at most {MAX_POINTS}; write it as .ply"
        )));
    }

    // Cells in the order of the image, x first.
    let at = |place: &[u32; 3]| {
        let [x, y, z] = std::array::from_fn(|axis| u64::from(place[axis] - low[axis]));
        x + sides[0] * (y + sides[1] * z)
    };
    let mut order: Vec<(u64, usize)> =
        places.iter().enumerate().map(|(row, place)| (at(place), row)).collect();
    order.sort_unstable();
    let columns = field.columns();
    header(out, &lattice, (low, high), points, &columns)?;
    for (_, values) in &columns {
        out.write_all(&(4 * points).to_le_bytes())?;
        let mut cells = order.iter().peekable();
        for point in 0..points {
            let row = cells.next_if(|(place, _)| *place == point).map(|(_, row)| *row);
            out.write_all(&row.map_or(0.0, |row| values[row] as f32).to_le_bytes())?;
        }
    }
    write!(out, "\n  </AppendedData>\n</VTKFile>\n")
}

fn span(places: &[[u32; 3]], from: u32, by: fn(u32, u32) -> u32) -> [u32; 3] {
    std::array::from_fn(|axis| places.iter().map(|place| place[axis]).fold(from, by))
}

fn header(
    out: &mut impl Write,
    lattice: &Lattice,
    (low, high): ([u32; 3], [u32; 3]),
    points: u64,
    columns: &[(&str, Vec<f64>)],
) -> io::Result<()> {
    let (o, h) = (lattice.origin_m(), lattice.spacing_m());
    let extent: Vec<String> = (0..3).map(|axis| format!("{} {}", low[axis], high[axis])).collect();
    let extent = extent.join(" ");
    writeln!(
        out,
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"1.0\" \
         byte_order=\"LittleEndian\" header_type=\"UInt64\">\n  <ImageData \
         WholeExtent=\"{extent}\" Origin=\"{} {} {}\" Spacing=\"{h} {h} {h}\">\n    <Piece \
         Extent=\"{extent}\">\n      <PointData Scalars=\"K\">",
        o.x, o.y, o.z
    )?;
    for (place, (name, _)) in columns.iter().enumerate() {
        let offset = place as u64 * (4 * points + 8);
        writeln!(
            out,
            "        <DataArray type=\"Float32\" Name=\"{name}\" format=\"appended\" \
             offset=\"{offset}\"/>"
        )?;
    }
    write!(
        out,
        "      </PointData>\n      <CellData/>\n    </Piece>\n  </ImageData>\n  <AppendedData \
         encoding=\"raw\">\n_"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::FieldLattice;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn every_cell_of_any_field_is_in_its_place_and_nothing_else(
            cells in prop::collection::btree_map(0u32..120, 1e-3..1e6f32, 1..20),
        ) {
            let shape = [4, 5, 6];
            let lattice = Lattice::new([1.0, 2.0, 3.0], 0.5, shape).unwrap();
            let places: Vec<_> = cells.keys().map(|&cell| lattice.place(CellId(cell))).collect();
            let field = FieldFile {
                points: places.iter().map(|&place| lattice.point_at(place).into()).collect(),
                stiffness: cells.values().copied().map(f64::from).collect(),
                std: None,
                counts: None,
                prior: None,
                lattice: Some(FieldLattice { origin_m: [1.0, 2.0, 3.0], spacing_m: 0.5, shape }),
                cells: Some(cells.keys().copied().collect()),
            };
            let mut bytes = Vec::new();
            fill(&mut bytes, &field).unwrap();
            let text = String::from_utf8_lossy(&bytes).into_owned();
            let extent = text.split("WholeExtent=\"").nth(1).unwrap().split('"').next().unwrap();
            let ends: Vec<u32> = extent.split(' ').map(|end| end.parse().unwrap()).collect();
            let start = bytes.windows(2).position(|pair| pair == b"\n_").unwrap() + 10;
            let mut numbers = bytes[start..].as_chunks::<4>().0.iter().map(|raw| f32::from_le_bytes(*raw));
            let mut found = BTreeMap::new();
            for z in ends[4]..=ends[5] {
                for y in ends[2]..=ends[3] {
                    for x in ends[0]..=ends[1] {
                        let number = numbers.next().unwrap();
                        if number != 0.0 {
                            found.insert(lattice.cell([x, y, z]).0, number);
                        }
                    }
                }
            }
            prop_assert_eq!(found, cells);
        }
    }

    #[test]
    fn numbers_stand_where_their_cells_are_and_zeros_elsewhere() {
        let shape = [4, 5, 6];
        let lattice = Lattice::new([1.0, 2.0, 3.0], 0.5, shape).unwrap();
        let places = [[2, 3, 1], [1, 3, 1], [1, 4, 2]];
        let field = FieldFile {
            points: places.iter().map(|&place| lattice.point_at(place).into()).collect(),
            stiffness: vec![20.0, 10.0, 30.0],
            std: None,
            counts: Some(vec![2, 1, 3]),
            prior: None,
            lattice: Some(FieldLattice { origin_m: [1.0, 2.0, 3.0], spacing_m: 0.5, shape }),
            cells: Some(places.iter().map(|&place| lattice.cell(place).0).collect()),
        };
        let mut bytes = Vec::new();
        fill(&mut bytes, &field).unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        assert!(text.contains("Extent=\"1 2 3 4 1 2\" Origin=\"1 2 3\" Spacing=\"0.5 0.5 0.5\""));
        let start = bytes.windows(2).position(|pair| pair == b"\n_").unwrap() + 2;
        let block = |at: usize| {
            let floats = bytes[start + at + 8..][..32].as_chunks::<4>().0;
            floats.iter().map(|raw| f32::from_le_bytes(*raw)).collect::<Vec<_>>()
        };
        assert_eq!(bytes[start..start + 8], 32_u64.to_le_bytes());
        assert_eq!(block(0), [10.0, 20.0, 0.0, 0.0, 0.0, 0.0, 30.0, 0.0]);
        assert_eq!(block(40), [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0]);
        assert!(text.contains("Name=\"N_obs\" format=\"appended\" offset=\"40\""));

        let error = fill(&mut Vec::new(), &FieldFile { lattice: None, ..field }).unwrap_err();
        assert!(error.to_string().contains("as .ply"));
    }
}
