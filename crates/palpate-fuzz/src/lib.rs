//! Every parser of palpate, as a function of bytes that nobody meant.
//!
//! A target may return what it likes; it must not panic, take more than five seconds or more than a
//! gigabyte. Where a checksum or a container stops mutations, a second target puts the bytes behind it.
//! Two programs drive them: `tests/mutated_seeds.rs`, which mutates the seeds for some seconds on stable
//! Rust and runs in CI, and libFuzzer, by `scripts/fuzz`.

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

/// Events of a log that are read: mutations may make many of few bytes.
const EVENTS: usize = 100_000;

/// A parser.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Reads bytes.
    pub run: fn(&[u8]),
    /// What to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All of them.
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

/// The target of a name.
pub fn target(name: &str) -> Option<Target> {
    TARGETS.into_iter().find(|target| target.name == name)
}

/// A log, of which every other one may break off.
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

/// Two npy files of a touch.
fn npy_folder(bytes: &[u8]) {
    let Some((length, arrays)) = bytes.split_first_chunk::<2>() else { return };
    let length = usize::from(u16::from_le_bytes(*length)).min(arrays.len());
    let (angles, torques) = arrays.split_at(length);
    let path = scratch::file("touch/angles.npy", angles);
    scratch::file("touch/torques.npy", torques);
    read_log(path.parent().expect("it has a folder"), &LogOptions::default());
}

/// A field.
fn npz(bytes: &[u8]) {
    let _ = black_box(from_bytes(bytes, "field"));
    if let Ok(arrays) = npz::read_npz_bytes(bytes, "field") {
        let _ = black_box(FieldFile::from_arrays(&arrays));
    }
}

/// A field one of whose arrays, named by the first byte, is changed by the rest.
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

/// An array with other bytes if it is text; else with other numbers at some places, eleven bytes each,
/// and if bytes remain, with more or fewer rows.
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

/// Bytes as the message of a whole bag.
fn mcap_message(bytes: &[u8]) {
    log("log.mcap", &seeds::bag_of_message(bytes));
}

fn urdf(bytes: &[u8]) {
    let _ = black_box(Robot::from_urdf(&String::from_utf8_lossy(bytes)));
}

/// A mesh, in the format that the first byte names, as the shape of a robot's link.
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

/// Writes the seeds of a target into a folder, as libFuzzer takes them.
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
