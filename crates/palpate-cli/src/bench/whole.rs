//! The step as a user runs it: [`Mapper::step`], on as many threads as it takes.

use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::{Arm, Mapper, MapperConfig, MapperError, Sample};
use palpate_work::touches::RecordedTouch;

use super::answers::{self, Answers};
use super::peak;
use super::recording::{Learner, Passes, milliseconds, play};
use crate::error::CliError;
use crate::output::Output;
use crate::pace::{Pace, PaceFigures};

/// A mapper under the clock.
pub(super) struct Whole {
    mapper: Mapper,
    pace: Option<Pace>,
    started: Instant,
    first_step: Option<Duration>,
    step_ms: Vec<f64>,
    contacts: Vec<f64>,
}

/// The box of the cells that were touched, in cells: first and last along x, y and z.
pub(super) type Touched = [[u32; 3]; 2];

/// What was measured.
pub(super) struct Measured {
    /// From the start of the command until its first step was made, ms.
    pub start_ms: f64,
    /// Every timed step, ms.
    pub step_ms: Vec<f64>,
    /// Points that each of them touched.
    pub contacts: Vec<f64>,
    /// How the pace was kept, if there was one.
    pub pace: Option<PaceFigures>,
    /// The most memory that the process held, bytes, if the system says.
    pub peak_bytes: Option<u64>,
    /// Frames remembered, and the bytes that memory holds.
    pub memory: (usize, usize),
    /// Cells touched.
    pub cells_touched: usize,
    /// Where they are; nowhere if there are none.
    pub touched: Touched,
    /// What was found of paths, if any were asked about.
    pub answers: Option<Answers>,
}

impl Whole {
    /// A mapper that knows nothing yet, in a command that began at `started`.
    pub(super) fn new(
        arm: &Arc<Arm>,
        config: MapperConfig,
        pace: Option<Pace>,
        started: Instant,
    ) -> Result<Self, MapperError> {
        let mapper = Mapper::new(Arc::clone(arm), config)?;
        let mapper = match &pace {
            Some(pace) => pace.keep(mapper),
            None => mapper,
        };
        let (step_ms, contacts) = (Vec::new(), Vec::new());
        Ok(Self { mapper, pace, started, first_step: None, step_ms, contacts })
    }

    /// Learns all passes, and is asked about the paths of other touches; the mapper is gone after
    /// it, and its memory free for what follows.
    pub(super) fn measure(
        mut self,
        touches: &[RecordedTouch],
        passes: Passes,
        asked: &[RecordedTouch],
        output: &Output,
    ) -> Result<Measured, CliError> {
        play(touches, passes, &mut self, output, "timing the step")?;
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
        // Where no step was timed, nobody will see the answers.
        let wanted = !asked.is_empty() && !self.step_ms.is_empty();
        let answers = wanted.then(|| answers::measure(&self.mapper, asked, output)).transpose()?;
        Ok(Measured {
            start_ms: self.first_step.map_or(0.0, milliseconds),
            step_ms: self.step_ms,
            contacts: self.contacts,
            pace: self.pace.as_ref().map(Pace::figures),
            peak_bytes,
            memory: self.mapper.memory(),
            cells_touched: field.cells.len(),
            touched,
            answers,
        })
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
