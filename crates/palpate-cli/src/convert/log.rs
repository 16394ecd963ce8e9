//! A log in another format, one sample after another.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use palpate::Sample;
use palpate_io::atomic::{self, IfExists};
use palpate_io::log::bag_write::{Compression, TouchWriter};
use palpate_io::log::write::{ArraysWriter, TableWriter};

use crate::error::CliError;
use crate::output::Output;
use crate::settings::Settings;
use crate::touches::{TouchEvent, Touches};
use crate::{interrupt, robot};

/// What a log becomes.
#[derive(Debug, Clone, Copy)]
pub(super) enum Format {
    Arrays,
    Table,
    Bag(Compression),
}

impl Format {
    /// The format that an ending means.
    pub(super) fn of(
        path: &Path,
        ending: &str,
        compression: Compression,
    ) -> Result<Self, CliError> {
        match ending {
            "" => Ok(Self::Arrays),
            "csv" => Ok(Self::Table),
            "mcap" => Ok(Self::Bag(compression)),
            _ => Err(CliError::Usage(format!(
                "`{}`: a log becomes .mcap, .csv, or, without an ending, a folder of arrays; give \
                 the output one of these",
                path.display()
            ))),
        }
    }
}

/// Something that takes touches.
enum Sink<'a, 'b> {
    Arrays(Box<ArraysWriter>),
    Table(Box<TableWriter<&'a mut BufWriter<&'b mut File>>>),
    Bag(Box<TouchWriter<&'a mut BufWriter<&'b mut File>>>),
}

impl Sink<'_, '_> {
    fn touch(&mut self, name: &str) -> io::Result<()> {
        match self {
            Self::Arrays(sink) => return sink.touch(name),
            Self::Table(sink) => sink.touch(name),
            Self::Bag(sink) => sink.touch(name),
        }
        Ok(())
    }

    fn sample(&mut self, sample: &Sample) -> io::Result<()> {
        match self {
            Self::Arrays(sink) => sink.sample(sample),
            Self::Table(sink) => sink.sample(sample),
            Self::Bag(sink) => sink.sample(sample),
        }
    }

    fn finish(self) -> io::Result<()> {
        match self {
            Self::Arrays(sink) => sink.finish(),
            Self::Table(sink) => sink.finish(),
            Self::Bag(sink) => sink.finish(),
        }
    }
}

/// Reads a log and writes it anew.
pub(super) fn convert(
    (input, path): (&Path, &Path),
    format: Format,
    settings: &Settings,
    output: &Output,
) -> Result<(), CliError> {
    let mut touches = Touches::open(&[input.to_owned()], &settings.log.options())?;
    if touches.are_external() {
        output.note(
            "the torques are external ones, which the output does not say: read it with --gravity \
             removed",
        );
    }
    if settings.log.pauses().is_some() {
        let arm = robot::load(&settings.robot, output)?;
        let config = settings.config()?;
        touches = touches.for_arm(&arm, &settings.log, (config.lattice, config.contact))?;
    }
    let Some(TouchEvent::Touch(first)) = touches.advance()? else {
        return Err(CliError::from(format!("`{}` holds no touch", input.display())));
    };
    let joints = touches.keep_joints();
    let failed = |source| CliError::Write { what: format!("`{}`", path.display()), source };
    let mut copy = Copying { touches: &mut touches, output, first, fault: None, count: (0, 0) };
    let joints = match (format, joints) {
        (Format::Bag(_), None) => Some(names_of_robot(settings, output)?),
        (_, joints) => joints,
    };
    match format {
        Format::Arrays => {
            let arrays = ArraysWriter::new(path).map_err(failed)?;
            let copied = copy.hand_on(Sink::Arrays(Box::new(arrays)));
            copy.ended(copied.map_err(failed))?;
        }
        Format::Table => {
            let written = atomic::write(path, IfExists::Replace, |out| {
                copy.hand_on(Sink::Table(Box::new(TableWriter::new(out, joints))))
            });
            let written = written.map_err(CliError::file);
            copy.ended(written)?;
        }
        Format::Bag(compression) => {
            let joints = joints.unwrap_or_default();
            let written = atomic::write(path, IfExists::Replace, |out| {
                let bag = TouchWriter::new(out, joints, compression)?;
                copy.hand_on(Sink::Bag(Box::new(bag)))
            });
            let written = written.map_err(CliError::file);
            copy.ended(written)?;
        }
    }
    let (touched, samples) = copy.count;
    touches.tell_warnings(output);
    let path = path.display();
    output.result(&format!("{touched} touches of {samples} samples in all are in `{path}`.\n"))
}

/// The joints of the robot that the settings name.
fn names_of_robot(settings: &Settings, output: &Output) -> Result<Vec<String>, CliError> {
    let arm = robot::load(&settings.robot, output)?;
    let name = settings.robot.name();
    output.note(&format!("the log names no joints; in the bag they have those of `{name}`"));
    Ok(arm.robot.joint_names().map(str::to_owned).collect())
}

/// Touches on their way.
struct Copying<'a> {
    touches: &'a mut Touches,
    output: &'a Output,
    /// The touch that was read already.
    first: String,
    /// What stopped the reading.
    fault: Option<CliError>,
    /// Touches and samples so far.
    count: (u64, u64),
}

impl Copying<'_> {
    /// Hands all touches on.
    fn hand_on(&mut self, mut sink: Sink<'_, '_>) -> io::Result<()> {
        let bar = self.output.progress(self.touches.samples(), "converting");
        sink.touch(&self.first)?;
        self.count.0 = 1;
        loop {
            let moment = match self.touches.advance() {
                Ok(_) if interrupt::pressed() => {
                    let kept = "; nothing was written".to_owned();
                    return Err(self.stopped(CliError::Interrupted { kept }));
                }
                Ok(moment) => moment,
                Err(error) => return Err(self.stopped(error)),
            };
            match moment {
                None => break,
                Some(TouchEvent::Touch(name)) => {
                    sink.touch(&name)?;
                    self.count.0 += 1;
                }
                Some(TouchEvent::Sample(sample)) => {
                    sink.sample(&sample)?;
                    self.count.1 += 1;
                    bar.inc(1);
                }
            }
        }
        bar.finish_and_clear();
        sink.finish()
    }

    /// Keeps what stopped the reading, so that the output is given up.
    fn stopped(&mut self, fault: CliError) -> io::Error {
        self.fault = Some(fault);
        io::Error::other("reading stopped")
    }

    /// What stopped the reading, or else the writing.
    fn ended(&mut self, written: Result<(), CliError>) -> Result<(), CliError> {
        match self.fault.take() {
            Some(fault) => Err(fault),
            None => written,
        }
    }
}
