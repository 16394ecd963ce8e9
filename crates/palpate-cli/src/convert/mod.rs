//! `palpate convert`: logs and fields from one format into another.

mod field;
mod log;

use std::path::PathBuf;

use palpate_io::log::bag_write::Compression;
use palpate_work::settings::named;

use crate::args::number_in;
use crate::error::CliError;
use crate::file_paths::{FilePaths, ending};
use crate::interrupt;
use crate::output::Output;
use crate::settings::RobotAndLogSettings;

const NOTES: &str = "Examples:
  palpate convert recording.mcap -o touches/            a folder of arrays for each touch
  palpate convert recordings/ -o touches.mcap           a bag of ROS 2
  palpate convert day.mcap -o touches.csv --split-idle  a table, split where the arm pauses
  palpate convert field.npz -o field.vti                an image for ParaView
  palpate convert field.npz -o field.glb                field and arm, for browsers and Blender
  palpate convert field.npz -o boxes.urdf --above 1     boxes for collision checks
  palpate convert field.npz -o scene.xml --above 1      points on springs, for MuJoCo
  palpate convert field.npz -o body.json                its elastic body, for --body

The ending of the output selects the format. For a log: .mcap, .csv, or no ending for a folder of \
arrays. For a field (.npz): .npz, .ply with the columns K, K_std and N_obs, .vti (ParaView), \
.mcap with a PointCloud2 of x y z K K_std, .glb with the arm of --robot where its last touch \
began, .urdf with boxes around the cells, for planners and simulators, or .xml, a MuJoCo model of \
at most 1000 points on springs, each for a block of cells. For the most likely elastic body of a \
field, if it has one: .json with springs of wood of 0.48 GPa, which can be corrected by hand and \
given to map and evaluate as --body; or .xml, a MuJoCo model with the learnt springs.

A bag has the names of the touches on the topic /palpate/touch, which palpate reads by default. \
Bags need joint names: if the log has none, those of --robot are used. Times are exact to the \
nanosecond in bags, and to the last bit elsewhere.";

/// Flags of `palpate convert`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// The log or the field
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Output file or folder; its ending selects the format
    #[arg(long, short, value_name = "OUT")]
    output: PathBuf,
    /// Compression of the chunks of a bag
    #[arg(long, value_name = "HOW", default_value = if cfg!(feature = "full") { "zstd" } else { "none" }, value_parser = named::<Compression>(&["zstd", "lz4", "none"]))]
    compression: Compression,
    /// Write only the cells of a field that are stiffer than this, N/m [default: 0]
    #[arg(long, value_name = "N/M", value_parser = number_in(0.0..=1e12, "a stiffness in N/m from 0 to 1e12"))]
    above: Option<f64>,
    #[command(flatten)]
    settings: RobotAndLogSettings,
}

/// Converts a log or a field.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings = args.settings.load()?;
    let to = ending(&args.output);
    let logs = std::slice::from_ref(&args.input);
    let mut places = FilePaths::read(&args.settings, &settings, logs);
    places.input("the input", Some(&args.input));
    if !to.is_empty() {
        places.output("the output", Some(&args.output))?;
    }
    interrupt::listen();
    if ending(&args.input) == "npz" {
        let (paths, above) = ((&*args.input, &*args.output, &*to), args.above);
        return field::Conversion { paths, above, compression: args.compression }
            .run(&settings, output);
    }
    if args.above.is_some() {
        let why = "--above selects cells of a field (.npz), but the input is a log";
        return Err(CliError::Usage(why.to_owned()));
    }
    let format = log::Format::of(&args.output, &to, args.compression)?;
    log::convert((&args.input, &args.output), format, &settings, output)
}
