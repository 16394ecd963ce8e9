//! Reads triangles from mesh files: STL (binary and text), OBJ, COLLADA.
//!
//! STL and OBJ are read by `mesh-loader`, COLLADA by [`super::dae`]. Vertices are in the file's
//! coordinates, for COLLADA with `<unit>` applied; the URDF's scale is applied later.

use super::dae;
use nalgebra::Point3;
use palpate::unstable::TriangleMesh;
use std::path::Path;

/// Part of every cache key; to be increased whenever the same bytes give other triangles.
pub(super) const MESH_VERSION: u32 = 1;

/// Reads a mesh; the extension of `path` gives the format, and `path` is not opened. The error is
/// the end of a message to the user.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<TriangleMesh, String> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let mesh = match ending.as_deref() {
        Some("stl") => {
            check_stl_length(bytes)?;
            loaded(mesh_loader::stl::from_slice(bytes))?
        }
        Some("obj") => {
            // Materials are not needed: their file is not opened.
            let no_file = |_: &Path| Err::<Vec<u8>, _>(std::io::ErrorKind::NotFound.into());
            loaded(mesh_loader::obj::from_slice(bytes, None::<&Path>, no_file))?
        }
        Some("dae") => {
            let text = String::from_utf8_lossy(bytes);
            dae::read(text.trim_start_matches('\u{feff}'))?
        }
        _ => return Err("is of an unknown format; convert it to .stl, .obj or .dae".to_owned()),
    };
    if mesh.triangles.is_empty() {
        return Err("holds no triangle".to_owned());
    }
    if mesh.vertices.iter().any(|vertex| vertex.iter().any(|number| !number.is_finite())) {
        return Err("holds a coordinate that is not finite".to_owned());
    }
    Ok(mesh)
}

/// Refuses a binary STL that is shorter than its header says; `mesh-loader` would accept it.
fn check_stl_length(bytes: &[u8]) -> Result<(), String> {
    let Some(count) = bytes.get(80..84).and_then(|raw| raw.first_chunk::<4>()) else {
        return Ok(());
    };
    let promised = u64::from(u32::from_le_bytes(*count));
    let held = (bytes.len() as u64 - 84) / 50;
    let start = &bytes[..bytes.len().min(1024)];
    let is_text = bytes.trim_ascii_start().starts_with(b"solid")
        && start.windows(5).any(|word| word == b"facet");
    if is_text || held >= promised {
        return Ok(());
    }
    Err(format!("is truncated: it holds {held} of the {promised} triangles that it promises"))
}

/// Joins the meshes that `mesh-loader` read. It did not panic on any of 400,000 mutated files, so
/// panics are not caught here.
fn loaded(scene: std::io::Result<mesh_loader::Scene>) -> Result<TriangleMesh, String> {
    let scene = scene.map_err(|error| format!("cannot be read: {error}"))?;
    let mut mesh = TriangleMesh::default();
    for part in scene.meshes {
        let offset = u32::try_from(mesh.vertices.len()).map_err(|_| "is too large".to_owned())?;
        if part.faces.iter().flatten().any(|&corner| corner as usize >= part.vertices.len()) {
            return Err("refers to a vertex that it does not hold".to_owned());
        }
        mesh.vertices.extend(part.vertices.iter().map(|v| Point3::from(v.map(f64::from))));
        mesh.triangles.extend(part.faces.iter().map(|face| face.map(|corner| corner + offset)));
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STL: &[u8] = include_bytes!("../../testdata/box.stl");
    const TEXT_STL: &[u8] = include_bytes!("../../testdata/box_text.stl");
    const OBJ: &[u8] = include_bytes!("../../testdata/box.obj");
    const DAE: &[u8] = include_bytes!("../../testdata/boxes.dae");

    fn read_as(bytes: &[u8], name: &str) -> Result<TriangleMesh, String> {
        read(bytes, Path::new(name))
    }

    /// Volume by the divergence theorem, positive if the normals of the triangles point outwards.
    fn volume(mesh: &TriangleMesh) -> f64 {
        let corners = |triangle: &[u32; 3]| triangle.map(|i| mesh.vertices[i as usize].coords);
        mesh.triangles.iter().map(corners).map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0).sum()
    }

    fn bounds(mesh: &TriangleMesh) -> [[f64; 3]; 2] {
        let ends = |axis: usize| mesh.vertices.iter().map(move |vertex| vertex[axis]);
        [
            [0, 1, 2].map(|axis| ends(axis).fold(f64::MAX, f64::min)),
            [0, 1, 2].map(|axis| ends(axis).fold(f64::MIN, f64::max)),
        ]
    }

    #[test]
    fn the_same_box_comes_out_of_every_format() {
        for (bytes, name) in [(STL, "a.STL"), (TEXT_STL, "a.stl"), (OBJ, "a.obj")] {
            let mesh = read_as(bytes, name).unwrap();
            assert_eq!(mesh.triangles.len(), 12, "{name}");
            assert_eq!(volume(&mesh), 6.0, "{name}");
            assert_eq!(bounds(&mesh), [[0.0; 3], [2.0, 1.0, 3.0]], "{name}");
        }
    }

    #[test]
    fn collada_gives_each_instance_of_the_scene_at_its_place() {
        let mesh = read_as(DAE, "boxes.dae").unwrap();
        assert_eq!(mesh.triangles.len(), 24, "twice the box, not what is hidden");
        assert!((volume(&mesh) - 12.0).abs() < 1e-9, "in metres: {}", volume(&mesh));
        let [low, high] = bounds(&mesh);
        let wanted = [[0.0, 0.0, 0.0], [10.0, 2.0, 3.0]]; // the rotated box: x 9 to 10, y 0 to 2
        for axis in 0..3 {
            assert!((low[axis] - wanted[0][axis]).abs() < 1e-9, "{low:?}");
            assert!((high[axis] - wanted[1][axis]).abs() < 1e-9, "{high:?}");
        }
    }

    #[test]
    fn a_mirroring_node_leaves_the_triangles_looking_outwards() {
        let text = String::from_utf8_lossy(DAE);
        let text = text.replace("<rotate>0 0 1 90</rotate>", "<scale>-1 1 1</scale>");
        assert!((volume(&dae::read(&text).unwrap()) - 12.0).abs() < 1e-9);
    }

    #[test]
    fn strips_and_fans_are_triangles() {
        let text = String::from_utf8_lossy(DAE);
        for (kind, corners) in
            [("tristrips", "1 3 5 7"), ("trifans", "1 3 7 5"), ("polygons", "1 3 7 5")]
        {
            let text = text.replace("triangles count=\"2\"", kind);
            let text = text.replacen("</triangles>", &format!("</{kind}>"), 1);
            let text = text.replace("1 3 7 1 7 5", corners);
            assert!((volume(&dae::read(&text).unwrap()) - 12.0).abs() < 1e-9, "{kind}");
        }
    }

    #[test]
    fn broken_meshes_are_reported() {
        let dae = |from: &str, to: &str| {
            let text = String::from_utf8_lossy(DAE);
            assert!(text.contains(from));
            read_as(text.replace(from, to).as_bytes(), "a.dae")
        };
        let cases = [
            (read_as(&STL[..400], "a.stl"), "6 of the 12 triangles"),
            (read_as(&[b"solid", &STL[5..400]].concat(), "a.stl"), "6 of the 12 triangles"),
            (read_as(b"", "a.stl"), "cannot be read"),
            (read_as(b"solid x\nendsolid x\n", "a.stl"), "no triangle"),
            (read_as(b"v 0 0 0\nf 1 2 3\n", "a.obj"), "cannot be read"),
            (read_as(b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "a.obj"), ""),
            (read_as(b"ply", "a.ply"), "convert it"),
            (read_as(b"<a>", "a.dae"), "not readable XML"),
            (read_as(b"<svg/>", "a.dae"), "not a COLLADA file: its root element is <svg>"),
            (dae("#box-positions\"", "#nothing\""), "`#nothing`"),
            (dae("1 3 7 1 7 5", "1 3 8 1 7 5"), "position 8 (from 0), but holds 8"),
            (dae("2000 1000 0", "2000 NaN 0"), "not finite"),
            (dae("2000 1000 0", "2000 x 0"), "`x` among the numbers of <float_array>"),
            (dae("4 4 4 4 4", "4 4 4 4 5"), "<vcount> of more corners"),
            (dae("meter=\"0.001\"", "meter=\"0\""), "unit of `0` m"),
            (dae("#turned\"", "#scene\""), "contain itself"),
        ];
        for (index, (result, wanted)) in cases.into_iter().enumerate() {
            let error = result.expect_err(wanted);
            assert!(error.contains(wanted), "case {index}: {error}");
        }
    }
}
