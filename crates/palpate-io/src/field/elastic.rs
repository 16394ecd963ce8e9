//! The arrays of an elastic body in the file of a field.
//!
//! | array            | shape | type | unit     | meaning                                                        |
//! |------------------|-------|------|----------|----------------------------------------------------------------|
//! | `elastic`        | bytes | u8   |          | JSON: bodies and their weights, friction, creep                |
//! | `residual_cells` | R     | u32  |          | indices of the touched cells                                   |
//! | `K_residual`     | R     | f64  | N/m      | stiffness of these cells that explains the bodies' residual    |
//! | `elastic_touch`  | T x 2 | u32  |          | for each learnt touch: number of samples, 1 if they have times |
//! | `elastic_time`   | S     | f64  | s        | times of the samples of all touches; 0 where there are none    |
//! | `elastic_q`      | S x n | f64  | rad or m | positions of these samples, as logged                          |
//! | `elastic_tau`    | S x n | f64  | N·m      | torques of these samples, as logged                            |
//!
//! The last four arrays exist only if mapping can be continued from the file.

use palpate::unstable::ElasticModel;
use palpate::{CellId, Lattice, Sample};

use super::file::springs;
use super::npz::{Array, Arrays, Data};
use super::saved::{SavedError, contradiction};

/// Adds the arrays of a body, and of the touches that it was learnt from.
pub(super) fn insert(arrays: &mut Arrays, model: &ElasticModel, touches: &[Vec<Sample>]) {
    let json = serde_json::to_string(model).expect("a body is plain data");
    arrays.insert("elastic", Array::text(&json));
    let cells = model.residual_cells.iter().map(|cell| cell.0).collect();
    arrays.insert("residual_cells", Array::flat(Data::U32(cells)));
    arrays.insert("K_residual", Array::flat(Data::F64(model.residual_n_per_m.clone())));
    if touches.is_empty() {
        return;
    }
    let n_joints = touches.iter().flatten().next().map_or(0, |sample| sample.q.len());
    let of_touch = |touch: &Vec<Sample>| [touch.len() as u32, u32::from(has_times(touch))];
    let rows = touches.iter().flat_map(of_touch).collect();
    arrays.insert("elastic_touch", Array::new(vec![touches.len(), 2], Data::U32(rows)));
    let times = touches.iter().flat_map(|touch| {
        let has_times = has_times(touch);
        touch.iter().map(move |sample| sample.time_s.filter(|_| has_times).unwrap_or(0.0))
    });
    arrays.insert("elastic_time", Array::flat(Data::F64(times.collect())));
    let samples: usize = touches.iter().map(Vec::len).sum();
    let mut table = |name, of: fn(&Sample) -> &Vec<f64>| {
        let numbers = touches.iter().flatten().flat_map(|sample| of(sample).iter().copied());
        arrays.insert(name, Array::new(vec![samples, n_joints], Data::F64(numbers.collect())));
    };
    table("elastic_q", |sample| &sample.q);
    table("elastic_tau", |sample| &sample.tau);
}

fn has_times(touch: &[Sample]) -> bool {
    touch.iter().all(|sample| sample.time_s.is_some_and(f64::is_finite))
}

/// A body, and the samples of the touches that it was learnt from (empty without these arrays).
type Learnt = (ElasticModel, Vec<Vec<Sample>>);

/// Reads the body of a field; `None` if there is none.
pub(super) fn read(arrays: &Arrays, lattice: &Lattice) -> Result<Option<Learnt>, SavedError> {
    if arrays.get("elastic").is_none() {
        return Ok(None);
    }
    let wrong = |what: String| contradiction(arrays, format!("the array `elastic`: {what}"));
    let again = "if an older palpate wrote it, learn the field again with `palpate map`";
    let mut model: ElasticModel = serde_json::from_str(&arrays.text("elastic")?)
        .map_err(|error| wrong(format!("{error}; {again}")))?;
    let cells = arrays.small_counts("residual_cells", &[None])?;
    model.residual_n_per_m = springs(arrays, "K_residual", cells.len())?;
    model.residual_cells = cells.into_iter().map(CellId).collect();
    model.check(lattice).map_err(|error| wrong(error.to_string()))?;
    let touches = match arrays.get("elastic_touch") {
        Some(_) => touches(arrays)?,
        None => Vec::new(),
    };
    Ok(Some((model, touches)))
}

fn touches(arrays: &Arrays) -> Result<Vec<Vec<Sample>>, SavedError> {
    let rows = arrays.small_counts("elastic_touch", &[None, Some(2)])?;
    let times = arrays.floats("elastic_time", &[None])?;
    let q = arrays.floats("elastic_q", &[Some(times.len()), None])?;
    let n_joints = arrays.require("elastic_q")?.shape()[1];
    let tau = arrays.floats("elastic_tau", &[Some(times.len()), Some(n_joints)])?;
    let rows = rows.as_chunks::<2>().0;
    let promised: u64 = rows.iter().map(|row| u64::from(row[0])).sum();
    if promised != times.len() as u64 {
        let what = format!(
            "the array `elastic_touch` promises {promised} samples, `elastic_time` holds {}",
            times.len()
        );
        return Err(contradiction(arrays, what));
    }
    let mut all = (0..times.len()).map(|sample| {
        let of = |table: &[f64]| table[sample * n_joints..(sample + 1) * n_joints].to_vec();
        Sample::new(Some(times[sample]), of(&q), of(&tau))
    });
    let touch = |&[samples, has_times]: &[u32; 2]| {
        let untimed = |sample: Sample| Sample::new(None, sample.q, sample.tau);
        let samples = all.by_ref().take(samples as usize);
        samples.map(|sample| if has_times == 0 { untimed(sample) } else { sample }).collect()
    };
    Ok(rows.iter().map(touch).collect())
}
