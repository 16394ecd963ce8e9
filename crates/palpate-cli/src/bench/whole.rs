//! The step as a user runs it: [`Mapper::step`], on as many threads as it uses.

use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::{Mapper, MapperError, Sample};
use palpate_work::quantile::quantile;

use super::figures::{Figures, MIB, Parts, Spread, middle};
use super::recording::{Learner, milliseconds, play};
use super::{Bench, answers, peak};
use crate::error::CliError;
use crate::output::Output;
use crate::pace::Pace;
use crate::settings::SettingsError;

/// A mapper whose steps are timed.
pub(super) struct Whole {
    mapper: Mapper,
    pace: Option<Pace>,
    started: Instant,
    first_step: Option<Duration>,
    step_ms: Vec<f64>,
    contacts: Vec<f64>,
}

impl Whole {
    /// A new mapper; `started` is when the command began.
    pub(super) fn new(bench: &Bench<'_>, started: Instant) -> Result<Self, SettingsError> {
        let mapper = Mapper::new(Arc::clone(&bench.arm), bench.config.clone());
        let (mapper, pace) = bench.args.pace.keep(mapper.map_err(SettingsError::value)?);
        let (step_ms, contacts) = (Vec::new(), Vec::new());
        Ok(Self { mapper, pace, started, first_step: None, step_ms, contacts })
    }

    /// Learns all passes, then measures answers about the paths of other touches. The mapper is
    /// dropped, so that its memory is free for what follows. `None` if no step was timed.
    pub(super) fn measure(
        mut self,
        bench: &Bench<'_>,
        output: &Output,
    ) -> Result<Option<Figures>, CliError> {
        let passes = bench.args.passes;
        play(&bench.recording, passes, &mut self, output, "timing the step")?;
        if self.step_ms.is_empty() {
            return Ok(None);
        }
        let peak_bytes = peak::resident_bytes(); // before the field is copied below
        let field = self.mapper.field();
        let mut touched = [[u32::MAX; 3], [0; 3]];
        for &cell in &field.cells {
            let place = field.lattice.place(cell);
            for axis in 0..3 {
                touched[0][axis] = touched[0][axis].min(place[axis]);
                touched[1][axis] = touched[1][axis].max(place[axis]);
            }
        }
        let asked = (!bench.asked.is_empty()).then_some(&bench.asked);
        let answers = asked.map(|asked| answers::measure(&self.mapper, asked, output));
        let (frames_remembered, memory_bytes) = self.mapper.memory();
        let (lattice, steps) = (&bench.config.lattice, self.step_ms.len());
        Ok(Some(Figures {
            robot: bench.arm.robot.name().to_owned(),
            estimator: bench.config.method,
            simulated: bench.args.logs.is_empty(),
            touches: bench.recording.len(),
            warm_passes: passes.warm,
            passes: passes.timed,
            spacing_m: lattice.spacing_m(),
            origin_m: lattice.origin_m().into(),
            shape: lattice.shape(),
            cells_declared: lattice.n_cells(),
            cells_touched: field.cells.len(),
            cells_touched_box: touched,
            threads: rayon::current_num_threads(),
            start_ms: self.first_step.map_or(0.0, milliseconds),
            steps,
            steps_per_second: 1e3 * steps as f64 / self.step_ms.iter().sum::<f64>(),
            step_ms: Spread {
                median: middle(&self.step_ms),
                p99: quantile(&self.step_ms, 0.99).unwrap_or(0.0),
            },
            contacts: middle(&self.contacts),
            parts: Parts::default(),
            peak_memory_mib: peak_bytes.map(|bytes| bytes as f64 / MIB),
            frames_remembered,
            memory_mib: memory_bytes as f64 / MIB,
            pace: self.pace.as_ref().map(Pace::figures),
            answers: answers.transpose()?,
        }))
    }
}

impl Learner for Whole {
    fn begin_touch(&mut self) {
        self.mapper.begin_touch();
    }

    fn step(&mut self, sample: &Sample, timed: bool) -> Result<(), MapperError> {
        let start = Instant::now();
        let report = self.mapper.step(sample)?;
        let took = start.elapsed();
        self.first_step.get_or_insert_with(|| self.started.elapsed());
        let learnt = report.external.is_some() && report.contacts > 0;
        match &mut self.pace {
            Some(pace) if timed => pace.fill(&mut self.mapper, &report, start),
            Some(pace) if learnt => pace.fill_as_set(&mut self.mapper),
            _ => {}
        }
        if timed && learnt {
            self.step_ms.push(milliseconds(took));
            self.contacts.push(report.contacts as f64);
        }
        Ok(())
    }

    fn end_touch(&mut self) -> Result<(), MapperError> {
        self.mapper.end_touch()
    }
}
