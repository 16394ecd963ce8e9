//! Reads the triangles of a COLLADA scene (`.dae`).
//!
//! `mesh-loader` is not used: it places each geometry only once even if the scene contains several
//! instances, adds geometries that are not in the scene, and panics on bad indices. Node transforms
//! and `<unit>` are applied; `<up_axis>` is *not*: RViz, MoveIt and Gazebo ignore it, so robot
//! files are made to be right without it.
//!
//! Triangles, strips, fans and polygons (split as fans) are read; lines, splines, skins, materials
//! and normals are ignored.

use super::xml;
use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use palpate::unstable::TriangleMesh;
use roxmltree::Node;
use std::collections::HashMap;

/// Largest number of nodes; a scene with more is refused: it may contain itself or be malicious.
const MAX_NODES: usize = 100_000;
/// Largest number of triangles; a scene with more is refused: it could not be baked.
const MAX_TRIANGLES: usize = 20_000_000;

/// Reads the text of a file. The error is the end of a message to the user.
pub(super) fn read(text: &str) -> Result<TriangleMesh, String> {
    let document = xml::parse(text)?;
    let root = document.root_element();
    if root.tag_name().name() != "COLLADA" {
        return Err(format!(
            "is not a COLLADA file: its root element is <{}>",
            root.tag_name().name()
        ));
    }
    let ids = root.descendants().filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let mut scene = Scene { ids, mesh: TriangleMesh::default() };
    let world_from_root = Matrix4::new_scaling(unit_m(root)?);
    let shown = child(root, "scene").and_then(|scene| child(scene, "instance_visual_scene"));
    let visual_scene = match shown {
        Some(instance) => Some(scene.target(instance, "url")?),
        None => root.descendants().find(|node| is(node, "visual_scene")),
    };
    match visual_scene {
        Some(visual_scene) => scene.walk(visual_scene, world_from_root)?,
        None => {
            for geometry in root.descendants().filter(|node| is(node, "geometry")) {
                scene.add(geometry, &world_from_root)?;
            }
        }
    }
    Ok(scene.mesh)
}

/// Whether a node is an element with this name, in any namespace: it differs between versions of
/// the format.
fn is(node: &Node<'_, '_>, name: &str) -> bool {
    node.is_element() && node.tag_name().name() == name
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| is(child, name))
}

fn unit_m(root: Node<'_, '_>) -> Result<f64, String> {
    let unit = child(root, "asset").and_then(|asset| child(asset, "unit"));
    let Some(meter) = unit.and_then(|unit| unit.attribute("meter")) else { return Ok(1.0) };
    let number = meter.trim().parse::<f64>().ok().filter(|unit| unit.is_finite() && *unit > 0.0);
    number.ok_or_else(|| format!("has a unit of `{meter}` m; wanted a number above 0"))
}

/// The elements of the file by id, and the mesh collected so far.
struct Scene<'a, 'i> {
    ids: HashMap<&'a str, Node<'a, 'i>>,
    mesh: TriangleMesh,
}

impl<'a, 'i> Scene<'a, 'i> {
    /// The element that an attribute such as `url="#id"` refers to.
    fn target(&self, node: Node<'a, 'i>, attribute: &str) -> Result<Node<'a, 'i>, String> {
        let url = node.attribute(attribute).unwrap_or_default();
        let target = url.strip_prefix('#').and_then(|id| self.ids.get(id));
        target.copied().ok_or_else(|| {
            format!("refers in <{}> to `{url}`, which it does not hold", node.tag_name().name())
        })
    }

    /// Adds all geometries below `top`.
    fn walk(&mut self, top: Node<'a, 'i>, world_from_top: Matrix4<f64>) -> Result<(), String> {
        let mut ahead = vec![(top, world_from_top)];
        let mut visited = 0;
        while let Some((parent, world_from_parent)) = ahead.pop() {
            visited += 1;
            if visited > MAX_NODES {
                return Err(format!("has more than {MAX_NODES} nodes; does one contain itself?"));
            }
            let world_from_node = world_from_parent * parent_from_node(parent)?;
            for child in parent.children().filter(Node::is_element) {
                match child.tag_name().name() {
                    "node" => ahead.push((child, world_from_node)),
                    "instance_node" => ahead.push((self.target(child, "url")?, world_from_node)),
                    "instance_geometry" => {
                        self.add(self.target(child, "url")?, &world_from_node)?;
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// Adds the triangles of one geometry.
    fn add(&mut self, geometry: Node<'a, 'i>, world: &Matrix4<f64>) -> Result<(), String> {
        let Some(mesh) = child(geometry, "mesh") else { return Ok(()) };
        let mirrored = world.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        for part in mesh.children().filter(Node::is_element) {
            let Some(polygons) = polygons(part)? else { continue };
            let positions = self.positions(part)?;
            let first = self.mesh.vertices.len();
            let offset = u32::try_from(first).map_err(|_| "has too many vertices".to_owned())?;
            let place = |p: &Point3<f64>| Point3::from((world * p.to_homogeneous()).xyz());
            self.mesh.vertices.extend(positions.iter().map(place));
            for mut triangle in polygons {
                if let Some(corner) = triangle.iter().find(|&&v| v as usize >= positions.len()) {
                    let n = positions.len();
                    return Err(format!("refers to position {corner} (from 0), but holds {n}"));
                }
                if mirrored {
                    triangle.swap(1, 2);
                }
                self.mesh.triangles.push(triangle.map(|corner| corner + offset));
            }
            if self.mesh.triangles.len() > MAX_TRIANGLES {
                return Err(format!("has more than {MAX_TRIANGLES} triangles"));
            }
        }
        Ok(())
    }

    /// The positions that a part refers to through its `VERTEX` input.
    fn positions(&self, part: Node<'a, 'i>) -> Result<Vec<Point3<f64>>, String> {
        let vertices = self.target(input(part, "VERTEX")?, "source")?;
        let source = self.target(input(vertices, "POSITION")?, "source")?;
        let array = child(source, "float_array").ok_or("has a source without <float_array>")?;
        let numbers: Vec<f64> = numbers(array)?;
        let accessor = source.descendants().find(|node| is(node, "accessor"));
        let setting = |name, default| {
            let text = accessor.and_then(|accessor| accessor.attribute(name));
            text.map_or(Some(default), |text| text.trim().parse::<usize>().ok())
        };
        let (Some(stride), Some(start)) = (setting("stride", 3), setting("offset", 0)) else {
            return Err("has an <accessor> whose stride or offset is not a whole number".to_owned());
        };
        if stride < 3 {
            return Err(format!("has positions of {stride} numbers; wanted at least 3"));
        }
        let rows = numbers.get(start..).unwrap_or_default().chunks(stride);
        Ok(rows.filter_map(|row| Some(Point3::from(*row.first_chunk::<3>()?))).collect())
    }
}

fn input<'a, 'i>(node: Node<'a, 'i>, semantic: &str) -> Result<Node<'a, 'i>, String> {
    let named = |input: &Node<'_, '_>| input.attribute("semantic") == Some(semantic);
    let input = node.children().filter(|child| is(child, "input")).find(named);
    input.ok_or_else(|| format!("has <{}> without {semantic} input", node.tag_name().name()))
}

/// The product of all transforms of a node, in their order.
fn parent_from_node(node: Node<'_, '_>) -> Result<Matrix4<f64>, String> {
    let mut product = Matrix4::identity();
    for element in node.children().filter(Node::is_element) {
        let name = element.tag_name().name();
        if !matches!(name, "matrix" | "translate" | "rotate" | "scale" | "lookat" | "skew") {
            continue;
        }
        let numbers: Vec<f64> = numbers(element)?;
        product *= match (name, numbers.as_slice()) {
            ("matrix", rows) if rows.len() == 16 => Matrix4::from_row_slice(rows),
            ("translate", &[x, y, z]) => Matrix4::new_translation(&Vector3::new(x, y, z)),
            ("scale", &[x, y, z]) => Matrix4::new_nonuniform_scaling(&Vector3::new(x, y, z)),
            ("rotate", &[x, y, z, angle_deg]) => {
                let axis = Unit::try_new(Vector3::new(x, y, z), 1e-12);
                axis.map_or_else(Matrix4::identity, |axis| {
                    Rotation3::from_axis_angle(&axis, angle_deg.to_radians()).to_homogeneous()
                })
            }
            _ => return Err(format!("has a <{name}> of {} numbers", numbers.len())),
        };
    }
    Ok(product)
}

/// The triangles of a part as indices of positions; `None` if the part is not a surface.
fn polygons(part: Node<'_, '_>) -> Result<Option<Vec<[u32; 3]>>, String> {
    let kind = part.tag_name().name();
    if !matches!(kind, "triangles" | "polylist" | "polygons" | "tristrips" | "trifans") {
        return Ok(None);
    }
    let inputs = || part.children().filter(|child| is(child, "input"));
    let offset = |input: Node<'_, '_>| match input.attribute("offset") {
        None => Some(0),
        Some(text) => text.trim().parse::<usize>().ok().filter(|&offset| offset < 64),
    };
    let last = inputs().map(offset).try_fold(0, |most, offset| Some(most.max(offset?)));
    let at = offset(input(part, "VERTEX")?);
    let (Some(last), Some(at)) = (last, at) else {
        return Err("has an <input> whose offset is not a whole number below 64".to_owned());
    };
    let mut triangles = Vec::new();
    for list in part.descendants().filter(|node| is(node, "p")) {
        let all: Vec<u32> = numbers(list)?;
        let corners: Vec<u32> = all.chunks_exact(last + 1).map(|corner| corner[at]).collect();
        match kind {
            "triangles" => triangles.extend(corners.as_chunks::<3>().0),
            "tristrips" => strip(&corners, &mut triangles),
            "polylist" => {
                let counts = child(part, "vcount").ok_or("has a <polylist> without <vcount>")?;
                let mut rest = corners.as_slice();
                for count in numbers::<usize>(counts)? {
                    let polygon = rest
                        .split_off(..count)
                        .ok_or("has a <vcount> of more corners than its <p>")?;
                    fan(polygon, &mut triangles);
                }
            }
            _ => fan(&corners, &mut triangles),
        }
    }
    Ok(Some(triangles))
}

fn fan(corners: &[u32], triangles: &mut Vec<[u32; 3]>) {
    let Some((&first, rest)) = corners.split_first() else { return };
    triangles.extend(rest.array_windows().map(|&[a, b]| [first, a, b]));
}

fn strip(corners: &[u32], triangles: &mut Vec<[u32; 3]>) {
    let windows = corners.array_windows().enumerate();
    triangles.extend(windows.map(|(i, &[a, b, c])| if i % 2 == 0 { [a, b, c] } else { [b, a, c] }));
}

/// The numbers in an element's text.
fn numbers<T: std::str::FromStr>(element: Node<'_, '_>) -> Result<Vec<T>, String> {
    let texts = element.children().filter_map(|child| child.text());
    let words = texts.flat_map(str::split_ascii_whitespace);
    let parse = |word: &str| {
        let name = element.tag_name().name();
        word.parse().map_err(|_| format!("holds `{word}` among the numbers of <{name}>"))
    };
    words.map(parse).collect()
}
