//! Converts a log to another format, sample by sample.

use std::f64::consts::TAU;
use std::io;
use std::path::Path;
use std::sync::Arc;

use palpate::Arm;
use palpate_io::atomic;
use palpate_io::log::bag_write::{BagWriter, Compression};
use palpate_io::log::write::{ArraysWriter, TableWriter, TouchWriter};
use palpate_work::inspect::counted;
use palpate_work::robot;
use palpate_work::touches::{TouchEvent, Touches};
use palpate_work::{Bar, Progress};

use crate::error::CliError;
use crate::output::Output;
use crate::settings::Settings;

/// Format of the output.
#[derive(Debug, Clone, Copy)]
pub(super) enum Format {
    Arrays,
    Table,
    Bag(Compression),
}

impl Format {
    /// The format that belongs to an ending.
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

/// Reads a log and writes it in another format.
pub(super) fn convert(
    (input, path): (&Path, &Path),
    format: Format,
    settings: &Settings,
    output: &Output,
) -> Result<(), CliError> {
    let mut touches = Touches::open(&[input.to_owned()], &settings.log.options())?;
    note_unrecorded(&touches, output);
    let mut loaded = None;
    let mut arm_of = |touches: &mut Touches| -> Result<Arc<Arm>, CliError> {
        let arm = loaded.take().map_or_else(|| arm_of_log(touches, settings, output), Ok)?;
        loaded = Some(Arc::clone(&arm));
        Ok(arm)
    };
    if settings.log.pauses().is_some() {
        let arm = arm_of(&mut touches)?;
        let config = settings.config()?;
        touches = touches.for_arm(&arm, &settings.log, config.lattice)?;
    }
    // Arrays have no joint names: their columns are in the robot's order.
    let (is_arrays, is_of_robot) =
        (matches!(format, Format::Arrays), settings.robot.robot.is_some());
    if is_arrays && is_of_robot {
        let arm = arm_of(&mut touches)?;
        touches.reorder_to(&arm);
    }
    let Some(TouchEvent::Touch(first)) = touches.advance()? else {
        return Err(CliError::from(format!("`{}` holds no touch", input.display())));
    };
    let joints = touches.keep_joints();
    if let Some(names) = joints.as_ref().filter(|_| is_arrays && !is_of_robot) {
        let names = names.join(", ");
        output.note(&format!(
            "arrays contain no joint names; their columns are in the order of the log: {names}; with --robot, in the \
             robot's order"
        ));
    }
    let joints = match (format, joints) {
        (Format::Bag(_), None) => {
            let name = settings.robot.name();
            output
                .note(&format!("the log contains no joint names; the bag gets those of `{name}`"));
            Some(arm_of(&mut touches)?.robot.joint_names().map(str::to_owned).collect())
        }
        (_, joints) => joints,
    };
    let bar = output.begin(touches.samples(), "frames", "converting");
    let mut copy =
        Copying { touches: &mut touches, output, bar, fault: None, count: (0, 0), beyond: 0 };
    let written = copy.write((path, format), joints, first);
    let Copying { bar, fault, count: (touched, samples), beyond, .. } = copy;
    drop(bar);
    fault.map_or(written, Err)?;
    touches.report_warnings(output);
    let is_said = settings.log.angle_unit_given().or(touches.describe().angle_unit).is_some();
    if 2 * beyond > samples && !is_said {
        output.warn(
            "most positions are beyond two turns, and are written as radians: if they are degrees, convert again with \
             --angle-unit deg",
        );
    }
    let path = path.display();
    let touches = counted(touched as usize, "touch");
    output.result(&format!("`{path}` contains {touches}, {samples} samples in all.\n"))
}

/// Notes what the output does not record of the torques.
fn note_unrecorded(touches: &Touches, output: &Output) {
    if touches.are_external() {
        output.note(
            "the torques are external ones, but the output does not record that: read it with --gravity \
             removed",
        );
    }
    if touches.are_currents() {
        output.note("the torques are motor currents, but the output does not record that");
    }
}

/// The robot in the settings, without the fingers that the log lacks.
fn arm_of_log(
    touches: &mut Touches,
    settings: &Settings,
    output: &Output,
) -> Result<Arc<Arm>, CliError> {
    let arm = robot::load(&settings.robot, output)?;
    touches.arm_of_logs(arm, &mut settings.robot.clone(), output)
}

/// State of a conversion.
struct Copying<'a> {
    touches: &'a mut Touches,
    output: &'a Output,
    bar: Box<dyn Bar>,
    /// The error that stopped the reading.
    fault: Option<CliError>,
    /// Number of touches and of samples so far.
    count: (u64, u64),
    /// Number of samples so far with a position beyond [`LARGEST_RAD`].
    beyond: u64,
}

/// Two turns, rad: if most samples have a position beyond it, the log is probably in degrees.
const LARGEST_RAD: f64 = 2.0 * TAU;

impl Copying<'_> {
    /// Writes the file or the folder, whole or not at all.
    fn write(
        &mut self,
        (path, format): (&Path, Format),
        joints: Option<Vec<String>>,
        first: String,
    ) -> Result<(), CliError> {
        let failed = |source| CliError::Write { what: format!("`{}`", path.display()), source };
        match format {
            Format::Arrays => {
                ArraysWriter::new(path).and_then(|out| self.hand_on(first, out)).map_err(failed)
            }
            Format::Table => {
                atomic::write(path, |out| self.hand_on(first, TableWriter::new(out, joints)))
                    .map_err(CliError::file)
            }
            Format::Bag(compression) => atomic::write(path, |out| {
                let bag = BagWriter::new(out, joints.unwrap_or_default(), compression)?;
                self.hand_on(first, bag)
            })
            .map_err(CliError::file),
        }
    }

    /// Passes `first`, the touch that has begun already, and all following events to `out`, and finishes it.
    ///
    /// An error gives up the output; an error of the reading is kept in `fault`.
    fn hand_on(&mut self, first: String, mut out: impl TouchWriter) -> io::Result<()> {
        let mut next = Some(TouchEvent::Touch(first));
        while let Some(event) = next {
            match event {
                TouchEvent::Touch(name) => {
                    out.touch(&name)?;
                    self.count.0 += 1;
                }
                TouchEvent::Sample(sample) => {
                    out.sample(&sample)?;
                    self.count.1 += 1;
                    self.beyond += u64::from(sample.q.iter().any(|q| q.abs() > LARGEST_RAD));
                    self.bar.step();
                }
            }
            next = match self.touches.advance() {
                Ok(_) if self.output.stopped() => {
                    Err(CliError::Interrupted { kept: "; nothing was written".to_owned() })
                }
                read => read,
            }
            .map_err(|fault| {
                self.fault = Some(fault);
                io::Error::other("reading stopped")
            })?;
        }
        out.finish()
    }
}
