//! The torques of all scored frames, as a table or as arrays.

use std::path::Path;

use nalgebra::DVector;
use palpate::Field;
use palpate_io::field::npz::{Array, Arrays, Data, write_npz};
use palpate_learn::bands::Band;
use palpate_work::csv;
use palpate_work::evaluate::make_unique;
use palpate_work::predict::{FrameResult, TouchResult};

use crate::error::CliError;
use crate::file_paths;

/// Format of a file of torques.
#[derive(Debug, Clone, Copy)]
pub(super) enum Format {
    /// One row for each frame.
    Csv,
    /// Arrays `<touch>/predicted` and so on; `<touch>#2/…` for a second touch with the same name.
    Npz,
}

impl Format {
    /// The format that belongs to a file's ending.
    pub(super) fn of(path: &Path) -> Result<Self, CliError> {
        file_paths::format_of(path, "table of torques", &[("csv", Self::Csv), ("npz", Self::Npz)])
    }

    /// Writes the file, whole or not at all.
    pub(super) fn write(
        self,
        path: &Path,
        results: &[TouchResult],
        field: &Field,
    ) -> Result<(), CliError> {
        match self {
            Self::Csv => file_paths::write(path, &table(results, field)),
            Self::Npz => write_npz(path, &npz(results, field)).map_err(CliError::file),
        }
    }
}

fn table(results: &[TouchResult], field: &Field) -> String {
    let bands: Vec<Option<Band>> = results.iter().map(|touch| touch.band(field)).collect();
    let any = bands.iter().any(Option::is_some);
    let joints = results.iter().find_map(|touch| Some(touch.frames.first()?.external.len()));
    let column = |name: &'static str| (1..=joints.unwrap_or(0)).map(move |j| format!("{name}_{j}"));
    let head = ["log", "touch", "frame", "time_s", "contacts"].map(str::to_owned).into_iter();
    let head = head.chain(column("predicted")).chain(column("external"));
    let head = head.chain(column("half_width").filter(|_| any)).collect();
    let rows = results.iter().zip(&bands).flat_map(|(touch, band)| {
        touch.frames.iter().enumerate().map(move |(number, frame)| {
            let names = [touch.log.display().to_string(), touch.name.clone()];
            let numbers = [
                frame.frame.to_string(),
                frame.time_s.map(|time| time.to_string()).unwrap_or_default(),
                frame.contacts.to_string(),
            ];
            let half_width = band.iter().flat_map(|band| &band.half_width[number]);
            let torques = frame.predicted.iter().chain(&frame.external).chain(half_width);
            let torques = torques.map(|torque| format!("{torque:.6}"));
            names.into_iter().chain(numbers).chain(torques).collect()
        })
    });
    csv::text(std::iter::once(head).chain(rows))
}

fn npz(results: &[TouchResult], field: &Field) -> Arrays {
    let mut arrays = Arrays::new();
    let mut taken = Vec::new();
    for touch in results {
        let mut name = touch.name.clone();
        make_unique(&mut name, &mut taken); // two logs may well have a touch of the same name
        let frames = &touch.frames;
        let mut put = |what: &str, array: Array| arrays.insert(format!("{name}/{what}"), array);
        put("frame", Array::flat(Data::U64(frames.iter().map(|frame| frame.frame).collect())));
        let contacts = frames.iter().map(|frame| frame.contacts as u64).collect();
        put("contacts", Array::flat(Data::U64(contacts)));
        put("predicted", torques(frames, |frame| &frame.predicted));
        put("external", torques(frames, |frame| &frame.external));
        if let Some(band) = touch.band(field) {
            let joints = band.half_width.first().map_or(0, Vec::len);
            let numbers = band.half_width.into_iter().flatten().collect();
            put("half_width", Array::new(vec![frames.len(), joints], Data::F64(numbers)));
        }
        if let Some(times) = frames.iter().map(|frame| frame.time_s).collect() {
            put("time_s", Array::flat(Data::F64(times)));
        }
    }
    arrays
}

fn torques(frames: &[FrameResult], of: impl Fn(&FrameResult) -> &DVector<f64>) -> Array {
    let joints = frames.first().map_or(0, |frame| of(frame).len());
    let numbers = frames.iter().flat_map(|frame| of(frame).iter().copied()).collect();
    Array::new(vec![frames.len(), joints], Data::F64(numbers))
}
