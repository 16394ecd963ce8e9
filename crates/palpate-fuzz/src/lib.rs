//! Fuzz targets for every parser of palpate: functions of arbitrary bytes.
//!
//! A target may return an error, but must not panic, nor take more than five seconds or a gigabyte.
//! If a checksum or a container prevents useful mutations, a second target mutates the content inside.
//! Two programs run the targets: `tests/mutated_seeds.rs`, which mutates the seeds on stable Rust and
//! runs in CI, and libFuzzer, through `scripts/fuzz`.

mod mutate;
mod scratch;
mod seeds;

use std::fs;
use std::hint::black_box;

use palpate::Robot;
use palpate_io::cloud;
use palpate_io::field::npz::{Array, Data};
use palpate_io::field::{FieldFile, from_bytes, npz};
use palpate_io::log::{self, LogOptions};
use palpate_io::rgbd;
use palpate_io::robot_files::{ArmOptions, CachePlace, load_arm};
use palpate_work::settings;

pub use mutate::Mutator;

/// Largest number of events that are read from a log: few mutated bytes may give many.
const EVENTS: usize = 100_000;

/// A fuzz target.
#[derive(Clone, Copy)]
pub struct Target {
    /// Name of the target.
    pub name: &'static str,
    /// Parses the bytes.
    pub run: fn(&[u8]),
    /// Returns the inputs from which mutations start.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
pub const TARGETS: [Target; 15] = [
    Target { name: "npy_folder", run: npy_folder, seeds: seeds::arrays },
    Target { name: "npz", run: npz, seeds: seeds::fields },
    Target { name: "npz_member", run: npz_member, seeds: seeds::members },
    Target { name: "table", run: |bytes| log("log.csv", bytes), seeds: seeds::table },
    Target { name: "parquet", run: |bytes| log("log.parquet", bytes), seeds: seeds::parquet },
    Target { name: "mcap", run: |bytes| log("log.mcap", bytes), seeds: seeds::bag },
    Target { name: "mcap_message", run: mcap_message, seeds: seeds::message },
    Target { name: "sqlite", run: |bytes| log("log.db3", bytes), seeds: seeds::database },
    Target { name: "urdf", run: urdf, seeds: seeds::robot },
    Target { name: "mesh", run: mesh, seeds: seeds::mesh },
    Target { name: "cloud", run: cloud, seeds: seeds::cloud },
    Target { name: "camera", run: camera, seeds: seeds::camera },
    Target { name: "picture", run: picture, seeds: seeds::picture },
    Target { name: "settings", run: settings, seeds: seeds::settings },
    Target { name: "question", run: question, seeds: seeds::question },
];

/// The target with this name.
pub fn target(name: &str) -> Option<Target> {
    TARGETS.into_iter().find(|target| target.name == name)
}

/// Reads a log; if its length is even, it may break off.
fn log(name: &str, bytes: &[u8]) {
    let until_break = bytes.len().is_multiple_of(2);
    let options = LogOptions { until_break, ..LogOptions::default() };
    read_log(&scratch::file(name, bytes), &options);
}

fn read_log(path: &std::path::Path, options: &LogOptions) {
    if let Ok(log) = log::open(path, options) {
        black_box(log.take(EVENTS).filter(Result::is_ok).count());
    }
}

/// Reads a touch of two npy files; the first two bytes are the length of the first file.
fn npy_folder(bytes: &[u8]) {
    let Some((length, arrays)) = bytes.split_first_chunk::<2>() else { return };
    let length = usize::from(u16::from_le_bytes(*length)).min(arrays.len());
    let (angles, torques) = arrays.split_at(length);
    let path = scratch::file("touch/angles.npy", angles);
    scratch::file("touch/torques.npy", torques);
    read_log(path.parent().expect("it has a folder"), &LogOptions::default());
}

/// Reads a field.
fn npz(bytes: &[u8]) {
    let _ = black_box(from_bytes(bytes, "field"));
    if let Ok(arrays) = npz::read_npz_bytes(bytes, "field") {
        let _ = black_box(FieldFile::from_arrays(&arrays));
    }
}

/// Reads a field in which one array is changed: the first byte selects it, the rest is the change.
fn npz_member(bytes: &[u8]) {
    let Some((which, rest)) = bytes.split_first() else { return };
    let mut arrays = seeds::arrays_of_field().clone();
    let names: Vec<String> = arrays.iter().map(|(name, _)| name.to_owned()).collect();
    let name = &names[usize::from(*which) % names.len()];
    let Some(array) = arrays.get(name) else { return };
    let changed = changed(array, rest);
    arrays.insert(name, changed);
    let _ = black_box(from_bytes(&npz::npz_bytes(&arrays), "field"));
}

/// A changed array. Bytes are replaced as a whole. In other arrays, every eleven bytes of the input
/// replace one number (three bytes of index, eight of a float); a remaining byte is the new number of
/// rows.
fn changed(array: &Array, bytes: &[u8]) -> Array {
    let mut numbers: Vec<f64> = match array.data() {
        Data::U8(_) => return Array::flat(Data::U8(bytes.to_vec())),
        Data::F64(numbers) => numbers.clone(),
        Data::F32(numbers) => numbers.iter().copied().map(f64::from).collect(),
        Data::I64(numbers) => numbers.iter().map(|number| *number as f64).collect(),
        Data::U64(numbers) => numbers.iter().map(|number| *number as f64).collect(),
        Data::U32(numbers) => numbers.iter().copied().map(f64::from).collect(),
    };
    let mut patches = bytes.chunks_exact(11);
    for patch in patches.by_ref() {
        let (at, number) = patch.split_at(3);
        let at = u32::from_le_bytes([at[0], at[1], at[2], 0]) as usize;
        let count = numbers.len().max(1);
        if let (Some(held), Ok(number)) = (numbers.get_mut(at % count), number.try_into()) {
            *held = f64::from_le_bytes(number);
        }
    }
    let mut shape = array.shape().to_vec();
    if let (Some(rows), [more, ..]) = (shape.first_mut(), patches.remainder()) {
        *rows = usize::from(*more);
        numbers.resize(shape.iter().product(), 0.0);
    }
    let data = match array.data() {
        Data::F64(_) | Data::U8(_) => Data::F64(numbers),
        Data::F32(_) => Data::F32(numbers.iter().map(|number| *number as f32).collect()),
        Data::I64(_) => Data::I64(numbers.iter().map(|number| *number as i64).collect()),
        Data::U64(_) => Data::U64(numbers.iter().map(|number| *number as u64).collect()),
        Data::U32(_) => Data::U32(numbers.iter().map(|number| *number as u32).collect()),
    };
    Array::new(shape, data)
}

/// Reads a valid bag whose messages are the bytes.
fn mcap_message(bytes: &[u8]) {
    log("log.mcap", &seeds::bag_of_message(bytes));
}

fn urdf(bytes: &[u8]) {
    let _ = black_box(Robot::from_urdf(&String::from_utf8_lossy(bytes)));
}

/// Loads a robot with a link whose shape is a mesh; the first byte selects its format.
fn mesh(bytes: &[u8]) {
    let Some((format, bytes)) = bytes.split_first() else { return };
    let ending = ["stl", "obj", "dae"][usize::from(*format) % 3];
    let mesh = scratch::file(&format!("mesh.{ending}"), bytes);
    let of_mesh = format!("<mesh filename=\"{}\"/>", mesh.display());
    let urdf = seeds::URDF.replace("<box size=\"0.3 0.1 0.1\"/>", &of_mesh);
    let path = scratch::file("robot.urdf", urdf.as_bytes());
    let mut options = ArmOptions { cache: CachePlace::Off, ..ArmOptions::default() };
    (options.bake.spacing_m, options.bake.margin_m) = (0.05, 0.1);
    let _ = black_box(load_arm(&path.to_string_lossy(), &options));
}

fn cloud(bytes: &[u8]) {
    let _ = black_box(cloud::read(&scratch::file("cloud", bytes)));
}

fn camera(bytes: &[u8]) {
    let path = scratch::file("camera", bytes);
    let _ = black_box((rgbd::read_camera(&path), rgbd::read_pose(&path)));
}

fn picture(bytes: &[u8]) {
    let path = scratch::file("picture", bytes);
    let _ = black_box(rgbd::read_colour(&path));
    let _ = black_box(rgbd::read_depth(&path, 0.001));
}

fn settings(bytes: &[u8]) {
    let path = scratch::file("settings.toml", bytes);
    if let Ok(settings) = settings::read(&path) {
        let _ = black_box(settings.config());
        let _ = black_box(settings.template());
    }
}

fn question(bytes: &[u8]) {
    let _ = black_box(palpate_live::fuzz::question(bytes, 2));
}

/// Writes the seeds of a target into a folder, as files for libFuzzer.
///
/// # Errors
///
/// If they cannot be written.
pub fn write_seeds(target: &Target, folder: &std::path::Path) -> std::io::Result<()> {
    fs::create_dir_all(folder)?;
    for (number, seed) in (target.seeds)().iter().enumerate() {
        fs::write(folder.join(format!("seed_{number}")), seed)?;
    }
    Ok(())
}
