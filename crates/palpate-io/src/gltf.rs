//! Meshes as binary glTF 2.0 (`.glb`), which browsers, Blender and most viewers open.
//!
//! Lengths are in m. palpate has z up and glTF has y up, so all meshes are children of a node that rotates them.

use std::io::{self, Write};

use serde_json::{Value, json};

/// A mesh with its pose in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Name of the mesh.
    pub name: String,
    /// Vertices in the frame of the mesh, m.
    pub vertices_m: Vec<[f32; 3]>,
    /// Unit normals at the vertices.
    pub normals: Vec<[f32; 3]>,
    /// sRGB colours of the vertices; the mesh is grey if there are none.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Indices of the vertices, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Homogeneous 4 x 4 transform from the frame of the mesh to the world, column by column.
    pub world_from_mesh: [f32; 16],
}

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// Binary part of the file, and the views and accessors that describe it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Appends rows of numbers and returns the index of their accessor, which gets minimum and maximum if `bounds`.
    fn put<const N: usize>(&mut self, rows: &[[f32; N]], bounds: bool) -> usize {
        let bytes = rows.as_flattened().iter().flat_map(|number| number.to_le_bytes());
        let mut accessor =
            json!({ "componentType": FLOAT, "count": rows.len(), "type": format!("VEC{N}") });
        if bounds {
            let of = |from: f32, better: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|axis| rows.iter().map(|row| row[axis]).fold(from, better)).collect()
            };
            accessor["min"] = json!(of(f32::INFINITY, f32::min));
            accessor["max"] = json!(of(f32::NEG_INFINITY, f32::max));
        }
        self.view(bytes, VERTICES, accessor)
    }

    fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let corners = triangles.as_flattened();
        let accessor =
            json!({ "componentType": UNSIGNED_INT, "count": corners.len(), "type": "SCALAR" });
        self.view(corners.iter().flat_map(|corner| corner.to_le_bytes()), INDICES, accessor)
    }

    fn view(&mut self, bytes: impl Iterator<Item = u8>, target: u32, mut accessor: Value) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        accessor["bufferView"] = json!(self.views.len());
        let length = self.bytes.len() - start;
        self.views.push(
            json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": target }),
        );
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

/// Converts an sRGB colour to the linear RGB of glTF, 0 to 1.
fn linear(colour: [u8; 3]) -> [f32; 3] {
    colour.map(|part| {
        let part = f32::from(part) / 255.0;
        if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
    })
}

/// Writes meshes as one scene.
///
/// # Errors
///
/// If writing fails, or the file would have more than 4 GiB.
pub fn write_glb(out: &mut dyn Write, meshes: &[Mesh]) -> io::Result<()> {
    let mut buffer = Buffer::default();
    let (mut nodes, mut shapes) = (vec![], vec![]);
    for mesh in meshes.iter().filter(|mesh| !mesh.triangles.is_empty()) {
        let mut attributes = json!({
            "POSITION": buffer.put(&mesh.vertices_m, true),
            "NORMAL": buffer.put(&mesh.normals, false),
        });
        if let Some(colours) = &mesh.colours {
            let colours: Vec<_> = colours.iter().map(|&colour| linear(colour)).collect();
            attributes["COLOR_0"] = json!(buffer.put(&colours, false));
        }
        let (indices, material) =
            (buffer.indices(&mesh.triangles), usize::from(mesh.colours.is_none()));
        let primitive =
            json!({ "attributes": attributes, "indices": indices, "material": material });
        shapes.push(json!({ "name": mesh.name, "primitives": [primitive] }));
        nodes.push(
            json!({ "name": mesh.name, "mesh": nodes.len(), "matrix": mesh.world_from_mesh }),
        );
    }
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let all: Vec<usize> = (0..nodes.len()).collect();
    nodes.push(json!({ "name": "z is up", "rotation": [-half, 0.0, 0.0, half], "children": all }));
    let material = |grey: f32| {
        let look = json!({ "baseColorFactor": [grey, grey, grey, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8 });
        json!({ "pbrMetallicRoughness": look })
    };
    let scene = json!({
        "asset": { "version": "2.0", "generator": concat!("palpate ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [nodes.len() - 1] }],
        "nodes": nodes,
        "meshes": shapes,
        "materials": [material(1.0), material(0.6)],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{ "byteLength": buffer.bytes.len() }],
    });
    let mut text = scene.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let size = |bytes: usize| u32::try_from(bytes).map_err(io::Error::other);
    out.write_all(b"glTF")?;
    for number in [2, size(28 + text.len() + buffer.bytes.len())?, size(text.len())?] {
        out.write_all(&number.to_le_bytes())?;
    }
    out.write_all(b"JSON")?;
    out.write_all(&text)?;
    out.write_all(&size(buffer.bytes.len())?.to_le_bytes())?;
    out.write_all(b"BIN\0")?;
    out.write_all(&buffer.bytes)
}
