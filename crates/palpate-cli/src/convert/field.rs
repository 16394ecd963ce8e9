//! Converts a field to another format.

use std::path::Path;

use nalgebra::{Isometry3, Point3};
use palpate::unstable::Joint;
use palpate_io::atomic;
use palpate_io::body;
use palpate_io::cloud::{self, Cloud, Column};
use palpate_io::field::npz::{read_npz, write_npz};
use palpate_io::field::{self, FieldFile, obstacles, write_vti};
use palpate_io::gltf::{self, Mesh};
use palpate_io::log::bag_write::{Compression, write_field};
use palpate_view::view_model::{DrawnCells, LinkShape, Scale};
use palpate_work::held_joints::of_field;
use palpate_work::robot;

use crate::error::CliError;
use crate::file_paths;
use crate::hull::Hulls;
use crate::output::Output;
use crate::settings::Settings;

/// Frame of the points in a message: the robot's base, by its usual name in ROS.
const FRAME: &str = "base_link";

/// Largest number of points on springs in a MuJoCo model, which MuJoCo still simulates in real time.
const MAX_SPRINGS: usize = 1_000;

/// A conversion of a field to another format.
pub(super) struct Conversion<'a> {
    /// Path of the field, path of the output, and the ending of the output.
    pub(super) paths: (&'a Path, &'a Path, &'a str),
    /// Only cells stiffer than this are written, N/m.
    pub(super) above: Option<f64>,
    pub(super) compression: Compression,
}

impl Conversion<'_> {
    /// Reads a field and writes it in the format of the ending.
    pub(super) fn run(&self, settings: &Settings, output: &Output) -> Result<(), CliError> {
        let (input, path, to) = self.paths;
        if to == "json" || (to == "xml" && self.above.is_none() && has_body(input)?) {
            write_body((input, path), to)?;
            return output.result(&format!("The elastic body is in `{}`.\n", path.display()));
        }
        if to == "glb" {
            let (cells, arm) = self.write_glb(settings, output)?;
            let path = path.display();
            return output.result(&format!("{cells} cells and {arm} are in `{path}`.\n"));
        }
        let arrays = read_npz(input).map_err(CliError::file)?;
        let mut field = FieldFile::from_arrays(&arrays).map_err(CliError::file)?;
        let is_made_of_stiff_cells = self.above.is_some() || ["urdf", "xml"].contains(&to);
        if is_made_of_stiff_cells {
            let above = self.above.unwrap_or(0.0);
            field = field.above(above);
            if field.points.is_empty() {
                return Err(self.nothing_above(above));
            }
        }
        let refused = |why: String| CliError::from(format!("`{}` {why}", input.display()));
        let mut what = format!("{} points", field.points.len());
        let written = match to {
            "npz" => write_npz(path, &field.to_arrays()).map_err(CliError::file),
            "ply" => write_ply(path, &field),
            "vti" => write_vti(path, &field).map_err(CliError::file),
            "mcap" => atomic::write(path, |out| write_field(out, &field, FRAME, self.compression))
                .map_err(CliError::file),
            "urdf" => {
                let boxes = obstacles::boxes(&field).map_err(refused)?;
                what = format!("{} boxes around {} cells", boxes.len(), field.points.len());
                file_paths::write(path, &obstacles::urdf(&boxes))
            }
            "xml" => {
                let springs = obstacles::springs(&field, MAX_SPRINGS).map_err(refused)?;
                let (count, side_mm) = (springs.points.len(), 2e3 * springs.radius_m);
                what = format!("{count} points on springs, one for each block of {side_mm:.0} mm,");
                file_paths::write(path, &obstacles::mujoco_xml(&springs))
            }
            _ => Err(CliError::Usage(format!(
                "`{}`: a field becomes .npz, .ply, .vti, .mcap, .glb, .urdf or .xml, its elastic body .json \
                 or .xml; give the output one of these endings",
                path.display()
            ))),
        };
        written?;
        if to == "npz" {
            output.note(
                "points with stiffness, standard deviation and counts, as OpenVSF reads them: settings, memory, bands and \
                 elastic body are left out, and `palpate predict` cannot use the file",
            );
        }
        output.result(&format!("{what} are in `{}`.\n", path.display()))
    }

    /// Writes the arm where its last touch began, or with all joints in the middle of their range, and the field as
    /// octahedra. Returns the number of cells and a description of the arm.
    fn write_glb(&self, settings: &Settings, output: &Output) -> Result<(usize, String), CliError> {
        let (input, path, _) = self.paths;
        let saved = field::load(input).map_err(CliError::file)?;
        let snapshot = saved.snapshot.as_ref();
        let arm = of_field(robot::load(&settings.robot, output)?, snapshot, output);
        robot::warn_of_other_robot((&saved.robot, saved.snapshot.as_ref()), &arm, output);
        let mut scale = Scale::default();
        scale.widen(&saved.field);
        let mut cells = scale.cells(&saved.field);
        if let Some(above) = self.above {
            cells = cells.above(above as f32);
        }
        if cells.points_m.is_empty() {
            return Err(self.nothing_above(self.above.unwrap_or(0.0)));
        }
        let own = snapshot.filter(|snapshot| snapshot.robot.1 == arm.fingerprint());
        let log = own.map(|snapshot| snapshot.sample_log.as_slice());
        let touched = log.and_then(|log| log.iter().rev().find(|touch| !touch.q.is_empty()));
        let (q, posture) = match touched.and_then(|touch| touch.q.get(..arm.robot.n_joints())) {
            Some(q) => (q.to_vec(), "where its last touch began"),
            None => (
                arm.robot.joints().iter().map(Joint::middle).collect(),
                "in the middle of its range",
            ),
        };
        let hulls = Hulls::of(&arm);
        let poses = hulls.poses(&arm, &q).map_err(|error| CliError::from(error.to_string()))?;
        let mut meshes: Vec<Mesh> =
            hulls.hulls.iter().zip(&poses).map(|(hull, pose)| link(hull, pose)).collect();
        meshes.push(octahedra(&cells));
        let written = atomic::write(path, |out| gltf::write_glb(out, &meshes));
        written.map_err(CliError::file)?;
        Ok((cells.points_m.len(), format!("`{}`, {posture},", arm.robot.name())))
    }

    fn nothing_above(&self, above: f64) -> CliError {
        CliError::from(format!(
            "`{}` has no cell stiffer than {above} N/m (--above); `palpate inspect` says how stiff its cells are",
            self.paths.0.display()
        ))
    }
}

fn has_body(input: &Path) -> Result<bool, CliError> {
    Ok(field::load(input).map_err(CliError::file)?.field.elastic.is_some())
}

fn link(hull: &LinkShape, world_from_link: &Isometry3<f64>) -> Mesh {
    let single = |numbers: [f64; 3]| numbers.map(|number| number as f32);
    let frame = world_from_link.to_homogeneous().map(|number| number as f32);
    Mesh {
        name: hull.name.clone(),
        vertices_m: hull.vertices_m.iter().map(|&vertex| single(vertex.into())).collect(),
        normals: hull.normals().iter().map(|&normal| single(normal.into())).collect(),
        colours: None,
        triangles: hull.triangles.clone(),
        world_from_mesh: std::array::from_fn(|at| frame.as_slice()[at]),
    }
}

/// An octahedron for each cell; its faces share no vertices, so that each face has its own normal.
fn octahedra(cells: &DrawnCells) -> Mesh {
    let mut mesh = Mesh {
        name: "field".to_owned(),
        vertices_m: vec![],
        normals: vec![],
        colours: Some(vec![]),
        triangles: vec![],
        world_from_mesh: std::array::from_fn(|at| if at % 5 == 0 { 1.0 } else { 0.0 }),
    };
    let colours = mesh.colours.get_or_insert_default();
    for ((point, radius), colour) in cells.points_m.iter().zip(&cells.radii_m).zip(&cells.colours) {
        for face in 0..8 {
            let sign = |axis: usize| if face >> axis & 1 == 0 { 1.0_f32 } else { -1.0 };
            let is_mirrored = sign(0) * sign(1) * sign(2) < 0.0;
            let first = mesh.vertices_m.len() as u32;
            for axis in if is_mirrored { [0, 2, 1] } else { [0, 1, 2] } {
                let mut corner = *point;
                corner[axis] += sign(axis) * radius;
                mesh.vertices_m.push(corner);
                mesh.normals.push([0, 1, 2].map(|axis| sign(axis) / 3.0_f32.sqrt()));
                colours.push(*colour);
            }
            mesh.triangles.push([first, first + 1, first + 2]);
        }
    }
    mesh
}

/// Writes the most likely elastic body.
fn write_body((input, path): (&Path, &Path), to: &str) -> Result<(), CliError> {
    let field = field::load(input).map_err(CliError::file)?.field;
    let model = field.elastic.ok_or_else(|| {
        CliError::from(format!(
            "`{}` has no elastic body; `palpate map --cloud` makes fields that have one",
            input.display()
        ))
    })?;
    let variant = model.likeliest();
    if to == "json" {
        return file_paths::write(path, &body::json(&variant.body));
    }
    if variant.stiffness_factors.iter().all(|&factor| factor == 0.0) {
        return Err(CliError::from(format!(
            "the touches of `{}` have rejected its elastic body: its stiffness factor is 0; .json has the \
             body as it was made from the cloud",
            input.display()
        )));
    }
    file_paths::write(path, &body::mujoco_xml(variant, model.friction))
}

fn write_ply(path: &Path, field: &FieldFile) -> Result<(), CliError> {
    let points = field.points.iter().map(|&point| Point3::from(point)).collect();
    let columns = field.columns();
    let columns: Vec<_> =
        columns.iter().map(|(name, numbers)| (*name, Column::F64(numbers))).collect();
    let cloud = Cloud::new(points, None);
    cloud::write_ply(path, &cloud, &columns).map_err(CliError::file)
}
