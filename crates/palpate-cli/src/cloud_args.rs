//! The cloud that a command is given: a file of points, or a picture with depth.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use palpate::unstable::ElasticBody;
use palpate_io::body;
use palpate_io::cloud::{self, Cloud};
use palpate_io::rgbd;
use palpate_learn::body::ObjectHints;
use palpate_work::elastic::{self, CloudWithViewpoint};
use palpate_work::settings::{pair, vector3};

use crate::error::CliError;
use crate::output::Output;

/// Flags for converting a picture with depth to points.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Picture with depth")]
pub(crate) struct CloudArgs {
    /// File of the camera, if it is not beside the picture as `camera.json` or `.yaml`; for a cloud, the
    /// camera that recorded it, of which only the position is used
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Pose of the camera, `camera_to_world`, if its file has none: a file of a 4 x 4 matrix, or
    /// seven numbers in one argument, "x y z qx qy qz qw", m
    #[arg(long, value_name = "FILE|NUMBERS", allow_hyphen_values = true)]
    camera_pose: Option<String>,
    /// Length of a unit of an integer depth image, m
    #[arg(long, value_name = "M", default_value_t = 0.001)]
    depth_unit_m: f64,
    /// Nearest and farthest depth that is used, m
    #[arg(long, value_name = "NEAR,FAR", value_parser = pair)]
    depth_range_m: Option<[f64; 2]>,
    /// Keep flying pixels, whose depth lies between that of a near and of a far surface
    #[arg(long)]
    keep_flying: bool,
    /// Low corner of the box in which points are kept, m, world frame
    #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true, requires = "crop_high_m")]
    crop_low_m: Option<[f64; 3]>,
    /// High corner of the box, m, world frame
    #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true, requires = "crop_low_m")]
    crop_high_m: Option<[f64; 3]>,
}

impl CloudArgs {
    /// The elastic body of a file, or else the candidates made from the clouds; and the points of all clouds.
    pub(crate) fn bodies(
        &self,
        (clouds, hints): (&[PathBuf], &ObjectHints),
        file: Option<&Path>,
        output: &Output,
    ) -> Result<(Vec<Arc<ElasticBody>>, Option<Cloud>), CliError> {
        let given = file.map(body::read).transpose().map_err(CliError::file)?;
        let of_camera = self.camera.is_some() || self.camera_pose.is_some();
        if clouds.is_empty() {
            if of_camera || self.crop_low_m.is_some() {
                let unused =
                    "--camera, --camera-pose and --crop-* need --cloud, which is not given";
                return Err(CliError::Usage(unused.to_owned()));
            }
            return Ok((given.into_iter().map(Arc::new).collect(), None));
        }
        if clouds.len() > 1 && of_camera {
            let ambiguous = "--camera and --camera-pose describe one picture, but several --cloud are given; leave \
                             them out (palpate then searches for the positions of the cameras), or give folders \
                             that contain the file of their camera";
            return Err(CliError::Usage(ambiguous.to_owned()));
        }
        let seen = clouds.iter().map(|path| Ok((self.read(path, output)?, self.viewpoint(path)?)));
        let seen: Vec<CloudWithViewpoint> = seen.collect::<Result<_, CliError>>()?;
        let bodies = match given {
            Some(body) => vec![Arc::new(body)],
            None => {
                let names: Vec<String> =
                    clouds.iter().map(|path| path.display().to_string()).collect();
                elastic::bodies(&seen, hints, &names.join("`, `"), output)?
            }
        };
        let points = seen.iter().flat_map(|(cloud, _)| cloud.points());
        let colours =
            seen.iter().flat_map(|(cloud, _)| cloud.colours().expect("read with colours"));
        let all = Cloud::new(points.copied().collect(), Some(colours.copied().collect()));
        Ok((bodies, Some(all)))
    }

    /// Reads points with colours: a PLY or PCD file, or a folder with colour, depth and camera.
    pub(crate) fn read(&self, path: &Path, output: &Output) -> Result<Cloud, CliError> {
        let crop = self.crop()?;
        if path.is_dir() {
            return self.picture(path, crop, output);
        }
        let reading = cloud::read(path).map_err(CliError::file)?;
        let name = path.display();
        if !reading.dropped.is_empty() {
            let dropped = reading.dropped.len();
            output.note(&format!("`{name}`: {dropped} rows without a finite point were left out"));
        }
        let Some(colours) = reading.cloud.colours() else {
            return Err(CliError::from(format!(
                "`{name}` has points but no colours, which distinguish the parts of the object; export it \
                 with red, green and blue, or give the folder of the colour and depth images"
            )));
        };
        let inside = |point: &Point3<f64>| {
            crop.is_none_or(|[low, high]| {
                (0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
            })
        };
        let kept = reading.cloud.points().iter().zip(colours).filter(|(point, _)| inside(point));
        let (points, colours): (Vec<_>, Vec<_>) = kept.map(|(p, c)| (*p, *c)).unzip();
        if points.is_empty() {
            return Err(CliError::from(format!(
                "no point of `{name}` lies in the box of --crop-*"
            )));
        }
        Ok(Cloud::new(points, Some(colours)))
    }

    fn picture(
        &self,
        folder: &Path,
        crop: Option<[Point3<f64>; 2]>,
        output: &Output,
    ) -> Result<Cloud, CliError> {
        let folder = picture_folder(folder);
        let colour =
            find(&folder, "colour image", &["color", "colour", "rgb"], &["png", "jpg", "jpeg"])?;
        let depth = find(&folder, "depth image", &["depth"], &["png", "tif", "tiff", "npy"])?;
        let camera = self.camera_file(&folder)?;
        if !(self.depth_unit_m.is_finite() && self.depth_unit_m > 0.0) {
            let found = self.depth_unit_m;
            return Err(CliError::Usage(format!(
                "--depth-unit-m is {found}; wanted a length above 0"
            )));
        }
        let (colour, depth) = (
            rgbd::read_colour(&colour).map_err(CliError::file)?,
            rgbd::read_depth(&depth, self.depth_unit_m).map_err(CliError::file)?,
        );
        let file = rgbd::read_camera(&camera).map_err(CliError::file)?;
        let camera = file.at(self.pose()?).ok_or_else(|| without_pose(&camera))?;
        let mut config =
            rgbd::BackProjectionConfig { crop, ..rgbd::BackProjectionConfig::default() };
        if let Some([near, far]) = self.depth_range_m {
            if !(near >= 0.0 && near < far) {
                let range = format!("--depth-range-m is {near},{far}; wanted 0 ≤ near < far");
                return Err(CliError::Usage(range));
            }
            config.depth_range_m = [near, far];
        }
        if self.keep_flying {
            config.flying = None;
        }
        let found =
            rgbd::back_project(&colour, &depth, &camera, &config).map_err(CliError::file)?;
        output.note(&format!(
            "{} points of the picture; left out: {}",
            found.cloud.len(),
            found.dropped
        ));
        Ok(found.cloud)
    }

    /// Position of the camera that recorded the cloud of [`CloudArgs::read`], m, world frame, if known.
    pub(crate) fn viewpoint(&self, path: &Path) -> Result<Option<Point3<f64>>, CliError> {
        let pose = match (self.pose()?, &self.camera) {
            (Some(pose), _) => Some(pose),
            (None, None) if !path.is_dir() => None,
            (None, _) => {
                let file = self.camera_file(&picture_folder(path))?;
                let camera = rgbd::read_camera(&file).map_err(CliError::file)?;
                Some(camera.world_from_camera.ok_or_else(|| without_pose(&file))?)
            }
        };
        Ok(pose.map(|pose| pose.translation.vector.into()))
    }

    /// The camera's file: that of `--camera`, or the one beside the picture.
    fn camera_file(&self, folder: &Path) -> Result<PathBuf, CliError> {
        match &self.camera {
            Some(file) => Ok(file.clone()),
            None => find(folder, "camera", &["camera", "camera_info"], &["json", "yaml", "yml"]),
        }
    }

    fn pose(&self) -> Result<Option<Isometry3<f64>>, CliError> {
        let Some(given) = &self.camera_pose else { return Ok(None) };
        let path = Path::new(given);
        let pose = if path.is_file() { rgbd::read_pose(path) } else { rgbd::pose_from_text(given) };
        pose.map(Some).map_err(CliError::file)
    }

    fn crop(&self) -> Result<Option<[Point3<f64>; 2]>, CliError> {
        let (Some(low), Some(high)) = (self.crop_low_m, self.crop_high_m) else { return Ok(None) };
        if (0..3).any(|axis| high[axis] <= low[axis]) {
            return Err(CliError::Usage(format!(
                "the box is turned inside out: --crop-high-m is {high:?}, which must be above \
                 --crop-low-m, {low:?}, on every axis"
            )));
        }
        Ok(Some([low.into(), high.into()]))
    }
}

fn without_pose(camera: &Path) -> CliError {
    let camera = camera.display();
    CliError::from(format!(
        "`{camera}` does not contain the pose of the camera; give --camera-pose"
    ))
}

/// The folder with the images: `rgbd` in the given folder if it exists, else the given folder.
fn picture_folder(folder: &Path) -> PathBuf {
    let within = folder.join("rgbd");
    if within.is_dir() { within } else { folder.to_owned() }
}

/// The first file in a folder that has one of the names with one of the endings.
fn find(folder: &Path, what: &str, names: &[&str], endings: &[&str]) -> Result<PathBuf, CliError> {
    let files = names
        .iter()
        .flat_map(|name| endings.iter().map(move |ending| folder.join(format!("{name}.{ending}"))));
    let tried: Vec<PathBuf> = files.collect();
    tried.iter().find(|file| file.is_file()).cloned().ok_or_else(|| {
        let names: Vec<String> =
            tried.iter().filter_map(|f| Some(f.file_name()?.to_string_lossy().into())).collect();
        let folder = folder.display();
        CliError::from(format!("`{folder}` holds no {what}: wanted {}", names.join(", ")))
    })
}
