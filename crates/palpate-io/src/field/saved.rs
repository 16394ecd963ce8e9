//! Files of a learnt field with its settings and, if mapping is to continue, the state of its mapper.
//!
//! In addition to the arrays of [`super::FieldFile`]:
//!
//! | array              | shape  | type | meaning                                                                     |
//! |--------------------|--------|------|-----------------------------------------------------------------------------|
//! | `palpate`          | bytes  | u8   | JSON: format, settings, robot, random generator                             |
//! | `state_mean`       | N      | f64  | z of `map` or mean of κ of `ekf`, N/m                                       |
//! | `state_variance`   | N      | f64  | (N/m)²                                                                      |
//! | `state_seen`       | N or 0 | u64  | `ekf`: step of each cell's last drift                                       |
//! | `memory_frame`     | F x 2  | u32  | touch and sample of each remembered frame                                   |
//! | `memory_alpha`     | F x n  | f64  | multipliers of each remembered frame (`map`; F x 0 for `ekf`)               |
//! | `memory_nis`       | F or 0 | f64  | normalised innovation squared of each frame at its last visit (0 for `ekf`) |
//! | `log_touch`        | T x 3  | u32  | number of the touch, its number of samples, 1 if it has not ended           |
//! | `log_q`, `log_tau` | S x n  | f64  | positions (rad or m) and torques (N·m) of all these samples, as logged      |
//! | `log_skipped`      | S      | u8   | 1 for a sample that was not learnt: too soon after another; only if any     |
//! | `log_tau_std`      | S x n  | f64  | standard deviations of these torques, N·m; −1 where a sample has none       |
//!
//! `log_tau_std` exists only for an identified arm. A field with an elastic body has more arrays: [`super::elastic`].
//!
//! The arrays from `state_mean` on exist only if mapping can be continued from the file. The
//! contacts of remembered frames are not stored: they are simulated again from the sample log, which
//! takes a hundredth of their size.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Point3;
use palpate::unstable::{EstimatorState, FrameId, LoggedTouch, NO_STD, RememberedFrame, RngState};
use palpate::{
    Calibration, CellId, ContactConfig, EstimatorKind, ExternalTorqueConfig, Field, Lattice,
    Mapper, MapperConfig, Sample, Snapshot,
};
use serde::{Deserialize, Serialize};

use super::elastic;
use super::file::{FieldFile, FieldLattice};
use super::npz::{Array, Arrays, Data, NpzError, npz_bytes, read_npz, read_npz_bytes, write_npz};

/// Version of the layout above; new optional arrays do not change it.
const FORMAT: u32 = 2;

/// Arrays with other names in format 1: the current name, then the old one.
const RENAMED: [(&str, &str); 5] = [
    ("memory_frame", "memory_source"),
    ("memory_nis", "memory_contradiction"),
    ("log_touch", "tape_touch"),
    ("log_q", "tape_q"),
    ("log_tau", "tape_tau"),
];

/// The name of an array in this file: the old one if the file has it.
fn name_in(arrays: &Arrays, name: &'static str) -> &'static str {
    let renamed = RENAMED.iter().find(|(now, then)| *now == name && arrays.get(then).is_some());
    renamed.map_or(name, |(_, then)| then)
}

/// A field, and the state of the mapper that learnt it if mapping is to continue.
#[derive(Debug, Clone)]
pub struct SavedField {
    /// The stiffness of all cells that were touched or have a prior of their own.
    pub field: Field,
    /// Prior mean of every cell of the field, N/m, by row; `None` if all cells have the prior of the
    /// settings. Stored as the array `K_prior`.
    pub prior_n_per_m: Option<Vec<f64>>,
    /// Name of the robot that made the touches.
    pub robot: String,
    /// State of the mapper, if the file contains it.
    pub snapshot: Option<Snapshot>,
    /// Samples of the touches that the elastic body was learnt from, if there is one and mapping is to continue.
    pub elastic_touches: Vec<Vec<Sample>>,
}

impl SavedField {
    /// The field of a mapper, with the state that it needs to continue.
    pub fn of_mapper(mapper: &Mapper) -> Self {
        let snapshot = mapper.snapshot();
        Self {
            field: mapper.field(),
            prior_n_per_m: mapper.prior_n_per_m(),
            robot: snapshot.robot.0.clone(),
            snapshot: Some(snapshot),
            elastic_touches: Vec::new(),
        }
    }

    /// A field without the state of a mapper, so that mapping cannot be continued, and without prior
    /// means by cell.
    pub fn of_field(field: Field, robot: &str) -> Self {
        let (robot, elastic_touches) = (robot.to_owned(), Vec::new());
        Self { field, prior_n_per_m: None, robot, snapshot: None, elastic_touches }
    }
}

/// Why a field could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum SavedError {
    /// The file is broken, or an array is missing or invalid.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// A field of another program, without lattice or settings.
    #[error(
        "`{path}` holds points and K but not the array `{missing}`, which says where the cells are \
         and how they were touched: it was not written by `palpate map`"
    )]
    Foreign { path: String, missing: &'static str },
    /// Settings that cannot be parsed.
    #[error("`{path}`: the settings in the array `palpate` cannot be read: {source}")]
    Settings { path: String, source: serde_json::Error },
    /// A file of a later version of palpate.
    #[error("`{path}` has format {found}; this palpate reads formats up to {FORMAT}: update it")]
    Format { path: String, found: u32 },
    /// Arrays that contradict each other.
    #[error("`{path}`: {what}")]
    Contradiction { path: String, what: String },
}

/// The JSON in the array `palpate`.
#[derive(Serialize, Deserialize)]
struct Meta {
    format: u32,
    version: String,
    robot: String,
    lattice: Lattice,
    contact: ContactConfig,
    touch: ExternalTorqueConfig,
    untouched_n_per_m: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    calibration: Option<Calibration>,
    mapper: Option<MapperMeta>,
}

/// The scalars of a [`Snapshot`].
#[derive(Serialize, Deserialize)]
struct MapperMeta {
    config: MapperConfig,
    fingerprint: u64,
    touches: u32,
    step: u64,
    rng: RngState,
    /// Number of rows, from the first, with a prior of their own; the others have the prior of the settings.
    #[serde(default)]
    expected: usize,
    /// Names of the touches in the sample log; empty if the log is empty.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    names: Vec<String>,
    /// Number of learnt touches that are no longer in the sample log; null in files of versions that did not count
    /// them.
    #[serde(default)]
    gone: Option<u32>,
    /// [`Snapshot::learnt_s`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    learnt_s: Option<f64>,
}

/// Writes a field atomically; an existing file is replaced.
///
/// # Errors
///
/// If the file cannot be written.
pub fn save(path: &Path, saved: &SavedField) -> Result<(), NpzError> {
    write_npz(path, &to_arrays(saved))
}

/// Reads a field that [`save`] wrote.
///
/// # Errors
///
/// If the file is missing, broken, of another program or of a later version of palpate.
pub fn load(path: &Path) -> Result<SavedField, SavedError> {
    from_arrays(&read_npz(path)?)
}

/// The bytes of the file that [`save`] writes, for programs that pass fields on.
pub fn to_bytes(saved: &SavedField) -> Vec<u8> {
    npz_bytes(&to_arrays(saved))
}

/// Reads a field from the bytes of a file; messages use `name` as the path.
///
/// # Errors
///
/// As [`load`].
pub fn from_bytes(bytes: &[u8], name: &str) -> Result<SavedField, SavedError> {
    from_arrays(&read_npz_bytes(bytes, name)?)
}

/// A field as named arrays.
fn to_arrays(saved: &SavedField) -> Arrays {
    let field = &saved.field;
    let prior = saved.prior_n_per_m.clone();
    let mut arrays = FieldFile { prior, ..FieldFile::from(field) }.to_arrays();
    let meta = Meta {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        robot: saved.robot.clone(),
        lattice: field.lattice.clone(),
        contact: field.contact.clone(),
        touch: field.touch.clone(),
        untouched_n_per_m: field.untouched_n_per_m,
        calibration: field.calibration.clone(),
        mapper: saved.snapshot.as_ref().map(|snapshot| MapperMeta {
            config: snapshot.config.clone(),
            fingerprint: snapshot.robot.1,
            touches: snapshot.touches,
            step: snapshot.state.step,
            rng: snapshot.state.rng,
            expected: snapshot.prior_means_n_per_m.len(),
            names: snapshot.sample_log.iter().map(|touch| touch.name.clone()).collect(),
            gone: Some(snapshot.gone),
            learnt_s: snapshot.learnt_s,
        }),
    };
    let json = serde_json::to_string(&meta).expect("settings are plain data");
    arrays.insert("palpate", Array::text(&json));
    if let Some(snapshot) = &saved.snapshot {
        insert_state(&mut arrays, &snapshot.state, snapshot.config.method);
        insert_sample_log(&mut arrays, snapshot);
    }
    if let Some(model) = &field.elastic {
        elastic::insert(&mut arrays, model, &saved.elastic_touches);
    }
    arrays
}

/// Adds the arrays of an estimator's state.
fn insert_state(arrays: &mut Arrays, state: &EstimatorState, method: EstimatorKind) {
    arrays.insert("state_mean", Array::flat(Data::F64(state.mean.clone())));
    arrays.insert("state_variance", Array::flat(Data::F64(state.variance.clone())));
    arrays.insert("state_seen", Array::flat(Data::U64(state.seen.clone())));
    let frames = state.remembered.len();
    let ids = state.remembered.iter().flat_map(|frame| [frame.id.touch, frame.id.sample]);
    arrays.insert("memory_frame", Array::new(vec![frames, 2], Data::U32(ids.collect())));
    let alphas: Vec<f64> =
        state.remembered.iter().flat_map(|frame| frame.alpha.iter().copied()).collect();
    let width = alphas.len().checked_div(frames).unwrap_or(0);
    arrays.insert("memory_alpha", Array::new(vec![frames, width], Data::F64(alphas)));
    let scored = match method {
        EstimatorKind::Map | EstimatorKind::Elastic => state.remembered.as_slice(),
        EstimatorKind::Ekf => &[], // it draws frames at random, without this number
    };
    let nis = scored.iter().map(|frame| frame.nis).collect();
    arrays.insert("memory_nis", Array::flat(Data::F64(nis)));
}

/// Adds the arrays of the sample log.
fn insert_sample_log(arrays: &mut Arrays, snapshot: &Snapshot) {
    let n_joints = snapshot.n_joints.max(1);
    let samples = |touch: &LoggedTouch| touch.q.len() / n_joints;
    let touches = (snapshot.sample_log.iter())
        .flat_map(|touch| [touch.touch, samples(touch) as u32, u32::from(touch.open)]);
    let rows = snapshot.sample_log.len();
    arrays.insert("log_touch", Array::new(vec![rows, 3], Data::U32(touches.collect())));
    let rows: usize = snapshot.sample_log.iter().map(samples).sum();
    let q = snapshot.sample_log.iter().flat_map(|touch| touch.q.iter().copied()).collect();
    arrays.insert("log_q", Array::new(vec![rows, n_joints], Data::F64(q)));
    let tau = snapshot.sample_log.iter().flat_map(|touch| touch.tau.iter().copied()).collect();
    arrays.insert("log_tau", Array::new(vec![rows, n_joints], Data::F64(tau)));
    if snapshot.sample_log.iter().any(|touch| !touch.skipped.is_empty()) {
        let skipped = snapshot.sample_log.iter().flat_map(|touch| {
            let others = samples(touch) - touch.skipped.len();
            touch.skipped.iter().copied().chain(std::iter::repeat_n(false, others))
        });
        arrays.insert("log_skipped", Array::flat(Data::U8(skipped.map(u8::from).collect())));
    }
    if snapshot.sample_log.iter().any(|touch| !touch.tau_std.is_empty()) {
        let std = snapshot.sample_log.iter().flat_map(|touch| {
            let none = touch.tau.len() - touch.tau_std.len();
            touch.tau_std.iter().copied().chain(std::iter::repeat_n(NO_STD, none))
        });
        arrays.insert("log_tau_std", Array::new(vec![rows, n_joints], Data::F64(std.collect())));
    }
}

/// Converts named arrays to a field, and checks that they agree.
fn from_arrays(arrays: &Arrays) -> Result<SavedField, SavedError> {
    let file = FieldFile::from_arrays(arrays)?;
    let path = || arrays.path().display().to_string();
    let foreign = |missing| SavedError::Foreign { path: path(), missing };
    if arrays.get("palpate").is_none() {
        return Err(foreign("palpate"));
    }
    let mut meta: Meta = serde_json::from_str(&arrays.text("palpate")?)
        .map_err(|source| SavedError::Settings { path: path(), source })?;
    // Older versions did not save `identified`; only torques of an identified arm have standard deviations.
    if arrays.get("log_tau_std").is_some() {
        meta.touch.identified = true;
        meta.mapper.iter_mut().for_each(|mapper| mapper.config.touch.identified = true);
    }
    if meta.format > FORMAT {
        return Err(SavedError::Format { path: path(), found: meta.format });
    }
    let cells = file.cells.ok_or_else(|| foreign("cells"))?;
    let mut field = Field::new(meta.lattice, meta.contact, meta.touch, meta.untouched_n_per_m);
    field.cells = cells.iter().map(|&cell| CellId(cell)).collect();
    field.std_n_per_m = file.std.ok_or_else(|| foreign("K_std"))?;
    field.counts = file.counts.ok_or_else(|| foreign("N_obs"))?;
    field.stiffness_n_per_m = file.stiffness;
    field.calibration = meta.calibration;
    if file.lattice != Some(FieldLattice::from(&field.lattice)) {
        let what = "the array `lattice` differs from the lattice in the settings";
        return Err(contradiction(arrays, what.to_owned()));
    }
    let untouched = field.untouched_n_per_m;
    if !(untouched >= 0.0 && untouched.is_finite()) {
        let what = format!(
            "the stiffness of untouched cells is {untouched} N/m; wanted a finite number from 0 on"
        );
        return Err(contradiction(arrays, what));
    }
    if let Some(cell) = field.cells.iter().find(|cell| !field.lattice.contains(**cell)) {
        let what = format!("cell {} is not in the lattice {:?}", cell.0, field.lattice.shape());
        return Err(contradiction(arrays, what));
    }
    check_points(arrays, &field, &file.points)?;
    let mut elastic_touches = Vec::new();
    if let Some((model, touches)) = elastic::read(arrays, &field.lattice)? {
        (field.elastic, elastic_touches) = (Some(Arc::new(model)), touches);
    }
    check_calibrations(arrays, &field, meta.mapper.is_some())?;
    let mut saved = SavedField {
        field,
        prior_n_per_m: file.prior,
        robot: meta.robot,
        snapshot: None,
        elastic_touches,
    };
    if let Some(mapper) = meta.mapper {
        let (touches, of_body) = (mapper.touches as usize, saved.elastic_touches.len());
        if touches < of_body {
            let what =
                format!("the field has learnt {touches} touches, but its elastic body {of_body}");
            return Err(contradiction(arrays, what));
        }
        saved.snapshot = Some(snapshot(arrays, mapper, &saved)?);
    }
    Ok(saved)
}

/// Largest distance of a point from its cell along an axis, as a share of the spacing; beyond it, the file is refused.
const ROUNDED: f64 = 0.01;

/// Refuses points that are not at their cells, for example if only one of `points` and `cells` was moved or sorted.
fn check_points(arrays: &Arrays, field: &Field, points: &[[f64; 3]]) -> Result<(), SavedError> {
    let lattice = &field.lattice;
    let is_off = |(cell, point): (&CellId, &[f64; 3])| {
        (lattice.point(*cell) - Point3::from(*point)).amax() > ROUNDED * lattice.spacing_m()
    };
    let Some(row) = field.cells.iter().zip(points).position(is_off) else { return Ok(()) };
    let what = format!(
        "row {row} (from 0) of `points` is not the position of its cell, {}: `points` and `cells` must agree, so \
         change both, in the same order",
        field.cells[row].0
    );
    Err(contradiction(arrays, what))
}

/// Refuses an invalid calibration, of the springs alone or with an elastic body, or one whose number of joints differs
/// from that of the sample log, if there is one.
fn check_calibrations(arrays: &Arrays, field: &Field, has_mapper: bool) -> Result<(), SavedError> {
    for calibration in field.calibration.iter().chain(field.bands()) {
        let n_joints = match has_mapper {
            true => arrays.require(name_in(arrays, "log_q"))?.shape()[1],
            false => calibration.floor_n_m.len(),
        };
        calibration.check(n_joints).map_err(|what| contradiction(arrays, what))?;
    }
    Ok(())
}

/// The error for arrays that contradict each other.
pub(super) fn contradiction(arrays: &Arrays, what: String) -> SavedError {
    SavedError::Contradiction { path: arrays.path().display().to_string(), what }
}

/// The remembered frames, and the number of multipliers of each.
fn remembered(arrays: &Arrays) -> Result<(Vec<RememberedFrame>, usize), SavedError> {
    let frames = arrays.small_counts(name_in(arrays, "memory_frame"), &[None, Some(2)])?;
    let frames = frames.as_chunks::<2>().0;
    let alphas = within(arrays, "memory_alpha", &[Some(frames.len()), None])?;
    let width = alphas.len().checked_div(frames.len()).unwrap_or(0);
    let nis = match arrays.get(name_in(arrays, "memory_nis")) {
        Some(_) => arrays.floats(name_in(arrays, "memory_nis"), &[None])?,
        None => Vec::new(), // files of versions that drew frames only at random
    };
    let remembered = frames.iter().enumerate().map(|(frame, &[touch, sample])| RememberedFrame {
        id: FrameId { touch, sample },
        alpha: alphas[frame * width..(frame + 1) * width].to_vec(),
        nis: nis.get(frame).copied().unwrap_or_default(),
    });
    Ok((remembered.collect(), width))
}

/// The state of the mapper in named arrays.
fn snapshot(
    arrays: &Arrays,
    mapper: MapperMeta,
    saved: &SavedField,
) -> Result<Snapshot, SavedError> {
    let (remembered, width) = remembered(arrays)?;
    let state = EstimatorState {
        mean: within(arrays, "state_mean", &[None])?,
        variance: within(arrays, "state_variance", &[None])?,
        counts: saved.field.counts.clone(),
        seen: arrays.counts("state_seen", &[None])?,
        step: mapper.step,
        remembered,
        rng: mapper.rng,
    };
    let (means, variances, cells) =
        (state.mean.len(), state.variance.len(), saved.field.cells.len());
    if means != cells || variances != cells {
        let what = format!("{cells} cells have {means} means and {variances} variances");
        return Err(contradiction(arrays, what));
    }
    let (n_joints, mut sample_log) = sample_log(arrays)?;
    for (touch, name) in sample_log.iter_mut().zip(mapper.names) {
        touch.name = name;
    }
    let gone = mapper.gone.unwrap_or(mapper.touches.saturating_sub(sample_log.len() as u32));
    let wanted = match mapper.config.method {
        EstimatorKind::Map | EstimatorKind::Elastic => n_joints,
        EstimatorKind::Ekf => 0,
    };
    if width != wanted && !state.remembered.is_empty() {
        let what = format!("remembered frames have {width} multipliers, wanted {wanted}");
        return Err(contradiction(arrays, what));
    }
    let prior = saved.prior_n_per_m.as_deref().unwrap_or_default();
    let Some(expected) = prior.get(..mapper.expected) else {
        let what = format!(
            "{} cells should have a prior of their own, but `K_prior` has {} numbers",
            mapper.expected,
            prior.len()
        );
        return Err(contradiction(arrays, what));
    };
    Ok(Snapshot {
        config: mapper.config,
        robot: (saved.robot.clone(), mapper.fingerprint),
        n_joints,
        cells: saved.field.cells.clone(),
        prior_means_n_per_m: expected.to_vec(),
        state,
        touches: mapper.touches,
        sample_log,
        gone,
        learnt_s: mapper.learnt_s,
        calibration: saved.field.calibration.clone(),
    })
}

/// Reads numbers of an estimator's state; an error if one is so large that results would not be finite.
fn within(arrays: &Arrays, name: &str, shape: &[Option<usize>]) -> Result<Vec<f64>, SavedError> {
    let numbers = arrays.floats(name, shape)?;
    arrays.check(name, &numbers, "numbers from -1e24 to 1e24", |number| number.abs() <= 1e24)?;
    Ok(numbers)
}

/// Reads the number of joints and the touches of the sample log.
fn sample_log(arrays: &Arrays) -> Result<(usize, Vec<LoggedTouch>), SavedError> {
    let touches = arrays.small_counts(name_in(arrays, "log_touch"), &[None, Some(3)])?;
    let touches = touches.as_chunks::<3>().0;
    let q = arrays.floats(name_in(arrays, "log_q"), &[None, None])?;
    let tau = arrays.floats(name_in(arrays, "log_tau"), &[None, None])?;
    let n_joints = arrays.require(name_in(arrays, "log_q"))?.shape()[1];
    let std = match arrays.get("log_tau_std") {
        Some(_) => {
            arrays.floats("log_tau_std", &[Some(q.len() / n_joints.max(1)), Some(n_joints)])?
        }
        None => Vec::new(),
    };
    let skipped = match arrays.get("log_skipped") {
        Some(_) => arrays.counts("log_skipped", &[Some(q.len() / n_joints.max(1))])?,
        None => Vec::new(),
    };
    let samples: u64 = touches.iter().map(|touch| u64::from(touch[1])).sum();
    if q.len() != tau.len() || samples.saturating_mul(n_joints as u64) != q.len() as u64 {
        let what = format!(
            "the sample log promises {samples} samples of {n_joints} joints and holds {} positions and \
             {} torques",
            q.len(),
            tau.len()
        );
        return Err(contradiction(arrays, what));
    }
    let mut start = 0;
    let mut logged = Vec::new();
    for &[touch, samples, open] in touches {
        let rows = start..start + samples as usize; // the sum of all was checked above
        let numbers = rows.start * n_joints..rows.end * n_joints;
        start = rows.end;
        logged.push(LoggedTouch {
            touch,
            name: String::new(),
            open: open != 0,
            lost: false,
            skipped: skipped.get(rows).unwrap_or_default().iter().map(|own| *own > 0).collect(),
            q: q[numbers.clone()].to_vec(),
            tau: tau[numbers.clone()].to_vec(),
            tau_std: std.get(numbers).unwrap_or_default().to_vec(),
        });
    }
    Ok((n_joints, logged))
}
