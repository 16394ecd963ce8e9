//! `palpate extrapolate`: the stiffness of cells that a camera saw and no touch reached
//! (Sec. III-B).
//!
//! [`run`] is the command; [`CloudArgs`] reads the camera's points, [`ExtrapolationJob`] extrapolates, and
//! [`summary`] is what it prints and draws.

mod summary;

use std::path::{Path, PathBuf};
use std::time::Instant;

use palpate_io::cloud::{self as clouds, Cloud, Column};
use palpate_io::field;
use palpate_io::field::npz::{Array, Arrays, Data, write_npz};
use palpate_learn::extrapolate::{
    Extrapolation, ExtrapolationConfig, ExtrapolationMethod, Features,
};
use palpate_work::extrapolate::{
    ExtrapolationJob, ExtrapolationSettings, filled, method_of, remembers,
};
use palpate_work::{held_joints, robot};

use crate::args::number_in;
use crate::cloud_args::CloudArgs;
use crate::error::CliError;
use crate::file_paths::{FilePaths, entries};
use crate::output::Output;
use crate::picture::Format;
use crate::settings::{RobotOnlySettings, Settings};
use crate::{file_paths, interrupt, logs};

pub(crate) use summary::ExtrapolationSummary;

const NOTES: &str = "Examples:
  palpate extrapolate field.npz plant.ply -o seen.ply
  palpate extrapolate field.npz plant_a/ -o seen.npz --field filled.npz
  palpate extrapolate field.npz plant.pcd -o seen.ply --method knn --features rgb
  palpate extrapolate field.npz plant.ply -o seen.ply --picture fig4.png --report seen.html --compare
  palpate map more/ --from filled.npz -o better.npz

A CLOUD is a PLY or PCD file with colours, or a folder (or its rgbd/) with color.png, depth.png \
and camera.json, in the frame of the robot's base, m. Take the picture before the touches, \
without the arm in it.

Points that look alike are assumed to be equally stiff:

  torque  a Gaussian process over features, learnt from the torques that the field remembers
  cells   a Gaussian process learnt from the stiffness of touched cells
  knn     the paper's method: the 50 touched points nearest in features, RBF weights

Without --method, palpate takes torque or cells, whichever predicts random halves of the \
remembered touches better from the other half; where both predict worse than the field alone, \
--field adds nothing to the field, with a warning.

Features are a colour (chroma: without brightness; rgb; oklab), height and shape, joined by `+`. \
The stiffness of a point is that of a cell of the field's lattice, as in the field itself. K_std \
is the uncertainty of the regression; single points differ more.

--field writes the field with an extrapolated prior mean for the cells that the camera saw and no \
touch reached: `palpate predict` then predicts with them, and `palpate map --from` continues with \
them. `palpate map --prior` starts a new field with these prior means, and nothing of what was \
learnt.

--compare predicts random halves of the remembered touches from the other half, with and without \
the prior, with every method and set of features.

--json prints {\"points\", \"touched\", \"method\", \"features\", \"stiffness\": {quantiles}, \
...}.";

/// Flags of `palpate extrapolate`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// A field that `palpate map` saved
    #[arg(value_name = "FIELD.npz")]
    from: PathBuf,
    /// A coloured cloud, or a folder with colour image, depth image and camera
    #[arg(value_name = "CLOUD")]
    cloud: PathBuf,
    /// Output file of the cloud, with K, K_std and touched for each point
    #[arg(long, short, value_name = "FILE.npz|.ply|.pcd")]
    output: PathBuf,
    /// Output file of the field, with a prior mean for the untouched cells at the cloud's points
    #[arg(long, value_name = "FIELD.npz")]
    field: Option<PathBuf>,
    /// How stiffness is extrapolated: torque, cells or knn [default: if the field has its memory, torque or cells,
    /// by random halves of its touches; else knn]
    #[arg(long, value_name = "NAME", value_parser = method_of)]
    method: Option<ExtrapolationMethod>,
    /// Features by which points are compared [default: chroma; rgb for knn]
    #[arg(long, value_name = "NAMES")]
    features: Option<Features>,
    /// Largest distance between a cell and the cloud's point to which it belongs, in cells [default: the field's
    /// contact distance plus one cell; 1.25 for knn]
    #[arg(long, value_name = "CELLS")]
    reach_cells: Option<f64>,
    /// Length scale of the features, in their standard deviations: points much farther apart are independent
    #[arg(long, value_name = "STD", default_value_t = ExtrapolationConfig::default().length_scale)]
    length_scale: f64,
    /// Compare methods and features on random halves of the remembered touches
    #[arg(long)]
    compare: bool,
    /// Number of random halves of --compare
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    halves: u32,
    /// Folder of a simulation's truth about the points, with which their order by stiffness is
    /// compared
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Draw the stiff part of the field with the arm, and the cloud in colours of its stiffness
    #[arg(long, value_name = "FILE.png|.svg")]
    picture: Option<PathBuf>,
    /// Smallest stiffness of the cells of the field in the picture, N/m [default: shows the stiffest
    /// 5 %]
    #[arg(long, value_name = "N_PER_M", requires = "picture", value_parser = number_in(0.0..=f64::MAX, "a stiffness from 0 on, N/m"))]
    threshold: Option<f64>,
    /// Write an interactive page, which opens in a browser without a network
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Say on the page that the touches are simulated
    #[arg(long, requires = "report")]
    simulated: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    depth: CloudArgs,
    #[command(flatten)]
    settings: RobotOnlySettings,
}

/// Extrapolates and writes the results.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let started = Instant::now();
    Ending::of(&args.output)?;
    let settings = args.settings.load()?;
    args.field.as_deref().map(file_paths::check_field_ending).transpose()?;
    args.check_places(&settings)?;
    let picture = args.picture.as_deref().map(Format::of).transpose()?;
    interrupt::listen();

    let saved = field::load(&args.from).map_err(CliError::file)?;
    let cloud = args.depth.read(&args.cloud, output)?;
    let truth = args.truth.as_deref().map(|folder| clouds::read_point_truth(folder, cloud.len()));
    let truth = truth.transpose().map_err(CliError::file)?;
    let arm = robot::load(&settings.robot, output)?;
    let arm = held_joints::of_field(arm, saved.snapshot.as_ref(), output);
    let names = [args.from.as_path(), args.cloud.as_path()];
    let halves = args.compare.then_some(args.halves);
    let drawn = args.picture.is_some() || args.report.is_some();
    let kept = "nothing was written";
    let given = args.given();
    let fills = args.field.is_some();
    let (arm, saved, cloud) = (&arm, &saved, &cloud);
    let work = ExtrapolationJob { arm, saved, names, cloud, given, halves, drawn, fills, kept };
    if args.compare && !remembers(saved) {
        return Err(CliError::from(format!(
            "`{}` remembers no touch to compare on; map its logs again without --no-memory",
            args.from.display()
        )));
    }
    let found = work.run(output)?;

    // Everything is made before anything is written.
    let (truth, simulated) = (truth.as_ref(), args.simulated);
    let summary = ExtrapolationSummary { work: &work, found: &found, truth, simulated };
    let drawing = picture.map(|_| summary.picture(args.threshold)).transpose()?;
    let page = args.report.as_ref().map(|_| summary.page()).transpose()?;
    write(&args.output, cloud, &found.extrapolation)?;
    if let Some(path) = &args.field {
        field::save(path, &filled(saved.clone(), &found.cells)).map_err(CliError::file)?;
        if saved.field.bands().is_some() && !found.cells.is_empty() {
            output.note("the new field has no bands: they were calibrated for the old one");
        }
    }
    if let (Some(path), Some(format), Some(drawing)) = (&args.picture, picture, &drawing) {
        format.write(path, drawing)?;
    }
    if let (Some(path), Some(page)) = (&args.report, &page) {
        file_paths::write(path, page)?;
    }
    let (files, elapsed) = ((args.output.as_path(), args.field.as_deref()), started.elapsed());
    if args.json {
        return output.json(&summary.json(files, elapsed));
    }
    output.result(&summary.text(files, elapsed))?;
    let filled = args.field.as_ref().filter(|_| !found.cells.is_empty());
    let Some(field) = filled else { return Ok(()) };
    let (field, robot) = (field.display().to_string(), logs::robot_flags(&settings.robot));
    let field = logs::quoted(&field);
    output.result(&format!("Next: palpate map LOG --from {field} -o FIELD.npz{robot}\n"))
}

/// Format of the output file of the cloud.
#[derive(Clone, Copy)]
enum Ending {
    Npz,
    Ply,
    Pcd,
}

impl Ending {
    /// The format that belongs to a file's ending.
    fn of(path: &Path) -> Result<Self, CliError> {
        let formats = [("npz", Self::Npz), ("ply", Self::Ply), ("pcd", Self::Pcd)];
        file_paths::format_of(path, "cloud", &formats)
    }
}

impl Args {
    /// Refuses outputs that cannot be written, or would replace an input or another output.
    fn check_places(&self, settings: &Settings) -> Result<(), CliError> {
        let mut places = FilePaths::read(&self.settings, settings, &[]);
        places.input("the field", Some(&self.from));
        places.input("the cloud", Some(&self.cloud));
        for folder in [Some(&self.cloud), Some(&self.cloud.join("rgbd")), self.truth.as_ref()] {
            for file in folder.iter().flat_map(|folder| entries(folder)) {
                places.input("a file that is read", Some(&file));
            }
        }
        places.output("the cloud (--output)", Some(&self.output))?;
        places.output("the field (--field)", self.field.as_deref())?;
        places.output("the picture (--picture)", self.picture.as_deref())?;
        places.output("the report (--report)", self.report.as_deref())
    }

    fn given(&self) -> ExtrapolationSettings {
        ExtrapolationSettings {
            method: self.method,
            features: self.features,
            reach_cells: self.reach_cells,
            length_scale: Some(self.length_scale),
        }
    }
}

/// Writes the cloud with K, its standard deviation and whether each point was touched, whole or not at all.
pub(crate) fn write(
    path: &Path,
    cloud: &Cloud,
    extrapolation: &Extrapolation,
) -> Result<(), CliError> {
    let Extrapolation { stiffness_n_per_m, std_n_per_m, touched } = extrapolation;
    let touched: Vec<u8> = touched.iter().map(|&touched| u8::from(touched)).collect();
    let colours = cloud.colours().expect("a cloud without colours was refused");
    let columns = [
        ("K", Column::F64(stiffness_n_per_m)),
        ("K_std", Column::F64(std_n_per_m)),
        ("touched", Column::U8(&touched)),
    ];
    match Ending::of(path)? {
        Ending::Ply => clouds::write_ply(path, cloud, &columns).map_err(CliError::file),
        Ending::Pcd => clouds::write_pcd(path, cloud, &columns).map_err(CliError::file),
        Ending::Npz => {
            let n = cloud.len();
            let points = cloud.points().iter().flat_map(|point| [point.x, point.y, point.z]);
            let mut arrays = Arrays::new();
            arrays.insert("points", Array::new(vec![n, 3], Data::F64(points.collect())));
            arrays.insert("colors", Array::new(vec![n, 3], Data::U8(colours.concat())));
            arrays.insert("K", Array::flat(Data::F64(stiffness_n_per_m.clone())));
            arrays.insert("K_std", Array::flat(Data::F64(std_n_per_m.clone())));
            arrays.insert("touched", Array::flat(Data::U8(touched)));
            write_npz(path, &arrays).map_err(CliError::file)
        }
    }
}
