//! Writes touches as arrays or as a table, one sample after another; [`super::bag_write`] writes
//! bags.
//!
//! Both read back identically, to the last bit: names of touches and joints, times, positions and
//! torques (arrays contain no joint names). A folder of arrays appears whole or not at all. Its
//! touches are read in natural order; if that differs from the order of writing, numbers are put
//! before their names. Characters that a folder name cannot have are replaced.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use palpate::Sample;
use tempfile::TempDir;

use super::folder;
use super::names::UniqueNames;
use crate::atomic;
use crate::npy::write_header;

/// Writes touches, one sample after another.
pub trait TouchWriter {
    /// Starts a touch; a name that was used before gets a number appended, in a bag when it is read.
    ///
    /// # Errors
    ///
    /// If a folder of arrays cannot be created, or that of the previous touch cannot be completed.
    fn touch(&mut self, name: &str) -> io::Result<()>;

    /// Writes a sample of the touch that was started last.
    ///
    /// # Errors
    ///
    /// If it cannot be written, or differs in the number of joints or in having a time from the first sample of the
    /// table or of the folder; in a bag, if it does not have one position and one torque per joint, or has a time
    /// that a header cannot represent.
    fn sample(&mut self, sample: &Sample) -> io::Result<()>;

    /// Completes the output; a folder of arrays gets its final name.
    ///
    /// # Errors
    ///
    /// If the rest cannot be written, or the folder cannot be renamed.
    fn finish(self) -> io::Result<()>;
}

/// Writes touches as a CSV table with columns for touch, time (if there is one), positions and
/// torques.
pub struct TableWriter<W: Write> {
    out: ::csv::Writer<W>,
    joints: Option<Vec<String>>,
    names: UniqueNames,
    /// Whether samples have a time, once the header is written.
    timed: Option<bool>,
}

impl<W: Write> TableWriter<W> {
    /// A table for samples of these joints, or of joints without names.
    pub fn new(out: W, joints: Option<Vec<String>>) -> Self {
        // The name of a touch may begin like a comment, with `#`: it is then quoted.
        let out = ::csv::WriterBuilder::new().comment(Some(b'#')).from_writer(out);
        Self { out, joints, names: UniqueNames::default(), timed: None }
    }

    fn header(&mut self, sample: &Sample) -> io::Result<bool> {
        let timed = sample.time_s.is_some();
        let mut row = vec!["touch".to_owned()];
        row.extend(timed.then(|| "time".to_owned()));
        match &self.joints {
            Some(joints) => {
                for what in ["position", "effort"] {
                    row.extend(joints.iter().map(|joint| format!("{joint}_{what}")));
                }
            }
            None => {
                for what in ["q", "tau"] {
                    row.extend((1..=sample.q.len()).map(|joint| format!("{what}{joint}")));
                }
            }
        }
        self.out.write_record(&row)?;
        self.timed = Some(timed);
        Ok(timed)
    }
}

impl<W: Write> TouchWriter for TableWriter<W> {
    fn touch(&mut self, name: &str) -> io::Result<()> {
        self.names.start(name);
        Ok(())
    }

    fn sample(&mut self, sample: &Sample) -> io::Result<()> {
        let timed = match self.timed {
            Some(timed) => timed,
            None => self.header(sample)?,
        };
        if timed != sample.time_s.is_some() {
            return Err(refused("only one of it and the first sample has a time"));
        }
        let mut row = vec![self.names.latest().to_owned()];
        row.extend(sample.time_s.map(|time_s| time_s.to_string()));
        row.extend(sample.q.iter().chain(&sample.tau).map(ToString::to_string));
        Ok(self.out.write_record(&row)?)
    }

    fn finish(mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Writes touches as folders of arrays, in a folder that appears when everything is written.
pub struct ArraysWriter {
    target: PathBuf,
    hidden: TempDir,
    _lock: File,
    names: UniqueNames,
    touch: Option<Touch>,
}

impl ArraysWriter {
    /// A writer for a folder that does not exist yet.
    ///
    /// # Errors
    ///
    /// If `target` exists, or its parent folder is not writable.
    pub fn new(target: &Path) -> io::Result<Self> {
        if target.exists() {
            let what = "it exists already; choose another name, or remove it";
            return Err(io::Error::new(io::ErrorKind::AlreadyExists, what));
        }
        let (hidden, lock) = atomic::hidden_folder(target)?;
        Ok(Self {
            target: target.to_owned(),
            hidden,
            _lock: lock,
            names: UniqueNames::default(),
            touch: None,
        })
    }

    fn end_touch(&mut self) -> io::Result<()> {
        self.touch.take().map_or(Ok(()), Touch::finish)
    }
}

impl TouchWriter for ArraysWriter {
    fn touch(&mut self, name: &str) -> io::Result<()> {
        self.end_touch()?;
        let plain: String = name
            .chars()
            .map(|c| if c.is_control() || "/\\:".contains(c) { '_' } else { c })
            .collect();
        // File systems allow names of 255 bytes; numbers may be added before and after the name.
        let plain = plain[..plain.floor_char_boundary(200)].trim_matches(['.', ' ']);
        self.names.start(if plain.is_empty() { "touch" } else { plain });
        let folder = self.hidden.path().join(self.names.latest());
        fs::create_dir(&folder)?;
        self.touch = Some(Touch { folder, files: None, rows: 0, joints: 0 });
        Ok(())
    }

    fn sample(&mut self, sample: &Sample) -> io::Result<()> {
        let touch = self.touch.as_mut().ok_or_else(|| refused("no touch was started for it"))?;
        touch.sample(sample)
    }

    fn finish(mut self) -> io::Result<()> {
        self.end_touch()?;
        let names = self.names.given();
        if !names.is_sorted_by(|a, b| folder::compare(a, b).is_lt()) {
            let written = names.iter().filter(|name| self.hidden.path().join(name).exists());
            for (place, name) in written.enumerate() {
                let numbered = self.hidden.path().join(format!("{place:03}_{name}"));
                fs::rename(self.hidden.path().join(name), numbered)?;
            }
        }
        fs::rename(self.hidden.keep(), &self.target)
    }
}

/// Files of the angles, of the torques, and of the times if there are any.
type Arrays = (BufWriter<File>, BufWriter<File>, Option<BufWriter<File>>);

/// The arrays of one touch; their headers are rewritten at the end, when the number of rows is
/// known.
struct Touch {
    folder: PathBuf,
    files: Option<Arrays>,
    rows: usize,
    joints: usize,
}

impl Touch {
    fn sample(&mut self, sample: &Sample) -> io::Result<()> {
        if self.files.is_none() {
            self.joints = sample.q.len();
            let make = |name: &str, shape: &[usize]| -> io::Result<BufWriter<File>> {
                let mut file = BufWriter::new(File::create(self.folder.join(name))?);
                write_header(&mut file, "<f8", shape)?;
                Ok(file)
            };
            let table = [0, self.joints];
            let time = sample.time_s.map(|_| make("time.npy", &table[..1])).transpose()?;
            self.files = Some((make("angles.npy", &table)?, make("torques.npy", &table)?, time));
        }
        let Some((angles, torques, time)) = &mut self.files else { return Ok(()) };
        if sample.q.len() != self.joints || sample.tau.len() != self.joints {
            return Err(refused("it has another number of joints than the first sample"));
        }
        let put = |file: &mut BufWriter<File>, values: &[f64]| {
            values.iter().try_for_each(|value| file.write_all(&value.to_le_bytes()))
        };
        put(angles, &sample.q)?;
        put(torques, &sample.tau)?;
        match (time, sample.time_s) {
            (Some(file), Some(time_s)) => put(file, &[time_s])?,
            (None, None) => {}
            _ => return Err(refused("only one of it and the first sample has a time")),
        }
        self.rows += 1;
        Ok(())
    }

    fn finish(self) -> io::Result<()> {
        let Some((angles, torques, time)) = self.files else {
            return fs::remove_dir(self.folder); // a touch without samples is not written
        };
        let table = [self.rows, self.joints];
        let mut files = vec![(angles, &table[..]), (torques, &table)];
        files.extend(time.map(|file| (file, &table[..1])));
        for (mut file, shape) in files {
            file.seek(SeekFrom::Start(0))?;
            write_header(&mut file, "<f8", shape)?;
            file.flush()?;
            file.get_ref().sync_all()?;
        }
        Ok(())
    }
}

fn refused(reason: &str) -> io::Error {
    let what = format!("a sample cannot be written: {reason}");
    io::Error::new(io::ErrorKind::InvalidData, what)
}
