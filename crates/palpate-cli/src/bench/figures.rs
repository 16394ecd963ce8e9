//! The results of one measurement, as JSON and as text.

use palpate::EstimatorKind;
use palpate_work::quantile::median;
use serde::Serialize;

use super::answers::Answers;
use crate::output::rows;
use crate::pace::PaceFigures;

pub(super) const MIB: f64 = (1 << 20) as f64;

/// Median and 99th percentile of a time.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Spread {
    /// Median, ms.
    pub(super) median: f64,
    /// 99th percentile, ms.
    pub(super) p99: f64,
}

/// The median; 0 if there are no numbers.
pub(super) fn middle(numbers: &[f64]) -> f64 {
    median(numbers).unwrap_or(0.0)
}

/// The figures of one configuration on one log; the names of the fields are the keys of `--json`.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Figures {
    pub robot: String,
    pub estimator: EstimatorKind,
    /// Whether the touches are the bundled ones, which are simulated.
    pub simulated: bool,
    pub touches: usize,
    pub warm_passes: u32,
    pub passes: u32,
    pub spacing_m: f64,
    /// The first point of the lattice.
    pub origin_m: [f64; 3],
    /// Number of points along x, y and z.
    pub shape: [u32; 3],
    pub cells_declared: u64,
    pub cells_touched: usize,
    /// The box around the touched cells: first and last cell along x, y and z.
    pub cells_touched_box: [[u32; 3]; 2],
    /// Threads of the whole step.
    pub threads: usize,
    /// Time from the start of the command to the end of the first step, including reading the log,
    /// ms.
    pub start_ms: f64,
    /// Number of timed steps.
    pub steps: usize,
    /// Inverse of the mean time of a step.
    pub steps_per_second: f64,
    pub step_ms: Spread,
    /// Median number of contacts in a step.
    pub contacts: f64,
    #[serde(flatten)]
    pub parts: Parts,
    /// Peak of the resident set; `null` if the system does not report it.
    pub peak_memory_mib: Option<f64>,
    pub frames_remembered: usize,
    pub memory_mib: f64,
    /// How `--rate` was kept, if it was given.
    pub pace: Option<PaceFigures>,
    /// The measurements of `--answers`, if it was given.
    pub answers: Option<Answers>,
}

/// The times of the parts of a step.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Parts {
    /// Median time of the simulator, on one thread.
    pub simulator_ms: f64,
    /// Median time of the update, on one thread.
    pub update_ms: f64,
    /// Median time of the replays per contact visited, ns; without replays, that of the update.
    pub ns_per_visit: f64,
    /// Median time of the whole update per contact visited, with the observation, prediction,
    /// correction and standard deviation of the new frame, ns.
    pub update_ns_per_visit: f64,
}

impl Figures {
    /// All figures as text.
    pub(super) fn text(&self) -> String {
        let mut text = self.heading() + &rows(&self.rows());
        if let Some(answers) = &self.answers {
            text += &format!("\n{}\n\n{}", answers.heading(), rows(&answers.rows()));
        }
        text
    }

    /// What was measured, and how.
    fn heading(&self) -> String {
        let [nx, ny, nz] = self.shape;
        let estimator = self.estimator.name();
        let touches = match (self.simulated, self.touches) {
            (true, n) => format!("Touches: {n} of the bundled ones, simulated"),
            (false, n) => format!("Touches: {n}"),
        };
        let paced = match &self.pace {
            Some(_) => "\nThe step is timed without replays; how many fit into the remaining time \
                        depends on the machine."
                .to_owned(),
            None => String::new(),
        };
        format!(
            "{}, estimator {estimator}, {nx} x {ny} x {nz} points every {:.1} mm, {} threads.\n\
             {touches}. Passes before the clock starts: {}; with it running: {}.\n\
             Timed: {} steps, those whose tare is known and which touch something.{paced}\n\n",
            self.robot,
            1e3 * self.spacing_m,
            self.threads,
            self.warm_passes,
            self.passes,
            self.steps,
        )
    }

    fn rows(&self) -> Vec<(&'static str, String)> {
        let (declared, touched) = (self.cells_declared, self.cells_touched);
        let peak = self.peak_memory_mib.map_or("unknown".to_owned(), |mib| format!("{mib:.1} MiB"));
        let frames = format!("{} in {:.1} MiB", self.frames_remembered, self.memory_mib);
        let mut rows = vec![
            ("steps a second", format!("{:.0}", self.steps_per_second)),
            ("step, median", format!("{:.3} ms", self.step_ms.median)),
            ("step, 99th percentile", format!("{:.3} ms", self.step_ms.p99)),
            ("points touched, median", format!("{:.0}", self.contacts)),
            ("simulator, one thread", format!("{:.3} ms", self.parts.simulator_ms)),
            ("update with replays, one thread", format!("{:.3} ms", self.parts.update_ms)),
        ];
        rows.extend(self.pace.as_ref().map(|pace| ("pace", pace.text())));
        let visit_ns = [self.parts.ns_per_visit, self.parts.update_ns_per_visit];
        let [visit, update] = visit_ns.map(|ns| format!("{ns:.2} ns"));
        rows.extend([
            ("a visit of one contact", visit),
            ("the update by contact visited", update),
            ("peak memory", peak),
            ("frames remembered", frames),
            ("cells touched", format!("{touched} of {declared}")),
            ("start to first step", format!("{:.0} ms", self.start_ms)),
        ]);
        rows
    }
}
