//! Files of an elastic body: JSON, which can be read and corrected by hand, and a MuJoCo model.
//!
//! The JSON is `{"segments": [...]}` with one segment a line, parents before their children; the keys
//! are the fields of [`Segment`], lengths in m in the world frame. [`read`] checks every number.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use palpate::unstable::{
    BLOCK_STIFFNESS_SHARES, ElasticBody, ElasticBodyError, ElasticVariant, Segment, SegmentKind,
};
use serde::Deserialize;

use crate::input;

/// Density of the bodies of the MuJoCo model, kg/m³; without gravity it only affects the dynamics.
const DENSITY_KG_PER_M3: f64 = 500.0;
/// Ratio of damping to stiffness of a joint, s.
const RELAXATION_S: f64 = 0.05;
/// Half the height of the box that represents a block, m.
const BLOCK_DEPTH_M: f64 = 0.025;

/// Why a body could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ElasticBodyFileError {
    /// The file cannot be read.
    #[error("`{}` cannot be read: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// Not the JSON of a body; the message says where.
    #[error("`{}` is not the JSON of an elastic body: {source}", path.display())]
    Json { path: PathBuf, source: serde_json::Error },
    /// Segments that do not form a valid body.
    #[error("`{}`: {source} (segments count from 0)", path.display())]
    Body { path: PathBuf, source: ElasticBodyError },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    segments: Vec<Segment>,
}

/// Reads the JSON of a body.
///
/// # Errors
///
/// If the file cannot be read, a key is missing or unknown, or the segments do not form a valid body.
pub fn read(path: &Path) -> Result<ElasticBody, ElasticBodyFileError> {
    let path = path.to_owned();
    let text = match input::read_text(&path, input::largest()) {
        Ok(text) => text,
        Err(source) => return Err(ElasticBodyFileError::Unreadable { path, source }),
    };
    match serde_json::from_str::<File>(&text) {
        Ok(file) => ElasticBody::new(file.segments)
            .map_err(|source| ElasticBodyFileError::Body { path, source }),
        Err(source) => Err(ElasticBodyFileError::Json { path, source }),
    }
}

/// The JSON of a body, one line for each segment.
pub fn json(body: &ElasticBody) -> String {
    let line = |segment| serde_json::to_string(segment).expect("a segment is plain data");
    let lines: Vec<String> = body.segments().iter().map(line).collect();
    format!("{{\"segments\": [\n{}\n]}}\n", lines.join(",\n"))
}

/// A body as a MuJoCo model: capsules and ellipsoids on ball joints with the learnt springs; the blocks of a cushion
/// are boxes on slide joints, with tendons between neighbours. There is no gravity, since the rest shape contains its
/// effect, and segments do not collide with each other.
pub fn mujoco_xml(variant: &ElasticVariant, friction: f64) -> String {
    let segments = variant.body.segments();
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); segments.len()];
    let mut roots = Vec::new();
    for (index, segment) in segments.iter().enumerate() {
        match segment.parent {
            Some(parent) => children[parent as usize].push(index),
            None => roots.push(index),
        }
    }
    let mut xml = format!(
        "<mujoco model=\"elastic body\">\n  <compiler angle=\"radian\"/>\n  \
         <option gravity=\"0 0 0\" integrator=\"implicitfast\"/>\n  <default>\n    \
         <geom density=\"{DENSITY_KG_PER_M3}\" friction=\"{friction}\" condim=\"3\" contype=\"1\" \
         conaffinity=\"2\"/>\n  </default>\n  <worldbody>\n"
    );
    // Depth first, with a stack of the tags that are still to be opened or closed.
    let mut left: Vec<(usize, bool)> = roots.iter().rev().map(|&root| (root, false)).collect();
    while let Some((index, is_open)) = left.pop() {
        if is_open {
            xml += "</body>\n";
            continue;
        }
        let tree = variant.body.trees()[index] as usize;
        xml += &opened(segments, index, variant.stiffness_factors[tree]);
        left.push((index, true));
        left.extend(children[index].iter().rev().map(|&child| (child, false)));
    }
    xml += "  </worldbody>\n";
    xml += &shear(variant);
    xml += "</mujoco>\n";
    xml
}

/// The springs between neighbouring blocks, as tendons on the difference of their heights.
fn shear(variant: &ElasticVariant) -> String {
    let (body, factors) = (&variant.body, &variant.stiffness_factors);
    let own = |block: usize| {
        let factor = factors[body.trees()[block] as usize];
        (body.segments()[block].joint_stiffness, factor)
    };
    let tendon = |(a, b, k): (usize, usize, f64)| {
        // The factor is the mean of both blocks' factors, weighted by their stiffness.
        let ((of_a, factor_a), (of_b, factor_b)) = (own(a), own(b));
        let stiffness = k * (of_a * factor_a + of_b * factor_b) / (of_a + of_b);
        format!(
            "<fixed springlength=\"0\" stiffness=\"{stiffness}\" damping=\"{}\"><joint joint=\"z_{a}\" \
             coef=\"1\"/><joint joint=\"z_{b}\" coef=\"-1\"/></fixed>\n",
            stiffness * RELAXATION_S
        )
    };
    let tendons: String = body.springs_between_blocks().map(tendon).collect();
    if tendons.is_empty() { tendons } else { format!("  <tendon>\n{tendons}  </tendon>\n") }
}

/// The start tag of a segment's body, with its joint and its shape.
fn opened(segments: &[Segment], index: usize, factor: f64) -> String {
    let segment = &segments[index];
    let carrier =
        segment.parent.map_or(Vector3::zeros(), |parent| segments[parent as usize].start().coords);
    let numbers = |v: Vector3<f64>| format!("{} {} {}", v.x, v.y, v.z);
    let (axis, radius) = (segment.axis(), segment.radius_m);
    let stiffness = segment.joint_stiffness * factor;
    let place = numbers(segment.start().coords - carrier);
    let mut xml = format!("<body name=\"segment_{index}\" pos=\"{place}\">\n");
    let mut joint = |kind: &str, stiffness: f64| {
        let damping = stiffness * RELAXATION_S;
        let _ = writeln!(xml, "<joint {kind} stiffness=\"{stiffness}\" damping=\"{damping}\"/>");
    };
    if segment.kind == SegmentKind::Block {
        for (name, axis, share) in [("x", "1 0 0", 0), ("y", "0 1 0", 1), ("z", "0 0 1", 2)] {
            let kind = format!("name=\"{name}_{index}\" type=\"slide\" axis=\"{axis}\"");
            joint(&kind, BLOCK_STIFFNESS_SHARES[share] * stiffness);
        }
    } else {
        joint("type=\"ball\"", stiffness);
    }
    let way = f64::min(segment.bare_m / axis.norm(), 0.9);
    let _ = match segment.kind {
        SegmentKind::Wood => writeln!(
            xml,
            "<geom type=\"capsule\" fromto=\"{} {}\" size=\"{radius}\" rgba=\"0.5 0.3 0.1 1\"/>",
            numbers(way * axis),
            numbers(axis)
        ),
        SegmentKind::Leaf => {
            let (along, across) = ((1.0 - way) * axis, segment.half_width());
            let across = across - axis * (across.dot(&axis) / axis.norm_squared());
            writeln!(
                xml,
                "<geom type=\"ellipsoid\" pos=\"{}\" size=\"{} {} {radius}\" xyaxes=\"{} {}\" \
                 rgba=\"0.2 0.6 0.2 1\"/>",
                numbers(0.5 * (1.0 + way) * axis),
                0.5 * f64::max(along.norm(), 1e-3),
                f64::max(across.norm(), 1e-3),
                numbers(axis),
                numbers(across.try_normalize(1e-9).unwrap_or_else(|| any_across(&axis)))
            )
        }
        // The top of the block.
        SegmentKind::Block => writeln!(
            xml,
            "<geom type=\"box\" pos=\"{}\" size=\"{} {} {}\" rgba=\"0.8 0.6 0.3 1\"/>",
            numbers(0.5 * axis - (BLOCK_DEPTH_M - radius) * Vector3::z()),
            0.5 * axis.xy().norm(),
            f64::max(segment.half_width().xy().norm(), 1e-3),
            BLOCK_DEPTH_M
        ),
    };
    xml
}

/// A unit vector perpendicular to an axis.
fn any_across(axis: &Vector3<f64>) -> Vector3<f64> {
    let other = if axis.x.abs() < 0.9 * axis.norm() { Vector3::x() } else { Vector3::y() };
    axis.cross(&other).normalize()
}
