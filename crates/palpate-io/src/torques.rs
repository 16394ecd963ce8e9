//! Writes the external torques of logs as CSV, Parquet or MCAP.
//!
//! A table has the columns `touch, time, <joint>_torque…, <joint>_std…, statistic`, then `fx` to `mz` if there is a
//! wrench, and `touched`. A bag has these topics, each message with the sample's time:
//!
//! | topic                         | type                         | content                                     |
//! |-------------------------------|------------------------------|---------------------------------------------|
//! | `/palpate/external_torque`    | `sensor_msgs/JointState`     | positions, external torques as efforts      |
//! | `/palpate/external_torque_std`| `std_msgs/Float64MultiArray` | standard deviations, in the same order      |
//! | `/palpate/touched`            | `std_msgs/Bool`              | whether something is touched                |
//! | `/palpate/wrench`             | `geometry_msgs/WrenchStamped`| if there is one: the wrench, in the link's frame |
//! | `/palpate/touch`              | `std_msgs/String`            | name, before the first sample of each touch |

use std::io::{self, Seek, Write};
use std::path::Path;

use crate::atomic::{self, WriteError};
use crate::log::bag_write::TorqueWriter;

/// External torque at a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct TorqueRow<'a> {
    /// Name of the touch that the sample belongs to.
    pub touch: &'a str,
    /// Time by the log's clock, s.
    pub time_s: Option<f64>,
    /// Joint positions, rad or m.
    pub q: &'a [f64],
    /// External torques, N·m.
    pub torque: &'a [f64],
    /// Standard deviations of the external torques, N·m.
    pub std: &'a [f64],
    /// The largest |torque| over its standard deviation.
    pub statistic: f64,
    /// Whether a contact is detected.
    pub touched: bool,
    /// Wrench at a link.
    pub wrench: Option<WrenchRow<'a>>,
}

/// Wrench at the origin of a link: force, N, then moment, N·m.
#[derive(Debug, Clone, PartialEq)]
pub struct WrenchRow<'a> {
    /// Name of the link.
    pub link: &'a str,
    /// Along the axes of the base, for tables.
    pub in_base: [f64; 6],
    /// Along the axes of the link, for bags.
    pub in_link: [f64; 6],
}

/// File format of external torques.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TorqueFormat {
    /// Table as text.
    Csv,
    /// Table stored by columns.
    Parquet,
    /// Bag for the tools of ROS 2.
    Mcap,
}

/// Writes all rows, or leaves no file; `joints` are the joint names in the order of the torques.
///
/// # Errors
///
/// If the file cannot be written, or the format cannot represent a time.
pub fn write(
    path: &Path,
    format: TorqueFormat,
    joints: &[String],
    rows: &[TorqueRow<'_>],
) -> Result<(), WriteError> {
    atomic::write(path, |out| match format {
        TorqueFormat::Csv => csv(out, joints, rows),
        #[cfg(feature = "formats")]
        TorqueFormat::Parquet => parquet(out, joints, rows).map_err(io::Error::other),
        #[cfg(not(feature = "formats"))]
        TorqueFormat::Parquet => Err(io::Error::other(crate::not_built("Parquet"))),
        TorqueFormat::Mcap => mcap(out, joints, rows),
    })
}

/// Names and values of all columns except `touch` and `touched`.
fn columns<'a>(joints: &'a [String], rows: &'a [TorqueRow<'a>]) -> Vec<(String, Vec<f64>)> {
    type Of = fn(&TorqueRow<'_>, usize) -> f64;
    let mut columns = Vec::new();
    if rows.iter().all(|row| row.time_s.is_some()) {
        let times = rows.iter().map(|row| row.time_s.unwrap_or_default());
        columns.push(("time".to_owned(), times.collect()));
    }
    let by_joint: [(&str, Of); 2] =
        [("torque", |row, j| row.torque[j]), ("std", |row, j| row.std[j])];
    for (what, of) in by_joint {
        for (j, joint) in joints.iter().enumerate() {
            columns.push((format!("{joint}_{what}"), rows.iter().map(|row| of(row, j)).collect()));
        }
    }
    columns.push(("statistic".to_owned(), rows.iter().map(|row| row.statistic).collect()));
    if rows.iter().any(|row| row.wrench.is_some()) {
        for (k, name) in ["fx", "fy", "fz", "mx", "my", "mz"].iter().enumerate() {
            let own = rows
                .iter()
                .map(|row| row.wrench.as_ref().map_or(f64::NAN, |wrench| wrench.in_base[k]));
            columns.push(((*name).to_owned(), own.collect()));
        }
    }
    columns
}

fn csv(out: &mut dyn Write, joints: &[String], rows: &[TorqueRow<'_>]) -> io::Result<()> {
    let columns = columns(joints, rows);
    let mut table = ::csv::Writer::from_writer(out);
    let names = columns.iter().map(|(name, _)| name.as_str());
    table.write_record(["touch"].into_iter().chain(names).chain(["touched"]))?;
    for (number, row) in rows.iter().enumerate() {
        let numbers = columns.iter().map(|(_, numbers)| numbers[number].to_string());
        let touched = u8::from(row.touched).to_string();
        table.write_record([row.touch.to_owned()].into_iter().chain(numbers).chain([touched]))?;
    }
    table.flush()
}

#[cfg(feature = "formats")]
fn parquet(
    out: impl Write + Send,
    joints: &[String],
    rows: &[TorqueRow<'_>],
) -> Result<(), ::parquet::errors::ParquetError> {
    use std::sync::Arc;

    use ::parquet::basic::{Compression, ZstdLevel};
    use ::parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType};
    use ::parquet::file::properties::WriterProperties;
    use ::parquet::file::writer::SerializedFileWriter;
    use ::parquet::schema::parser::parse_message_type;

    let columns = columns(joints, rows);
    // Names that the text of a schema cannot contain are replaced by column numbers.
    let is_plain = |name: &str| name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    let name = |(number, (name, _)): (usize, &(String, Vec<f64>))| {
        let name = if is_plain(name) { name.clone() } else { format!("column_{number}") };
        format!("required double {name};")
    };
    let fields: String = columns.iter().enumerate().map(name).collect();
    let schema = format!(
        "message torques {{ required binary touch (UTF8); {fields} required boolean touched; }}"
    );
    let compression = Compression::ZSTD(ZstdLevel::default());
    let properties = WriterProperties::builder().set_compression(compression).build();
    let schema = Arc::new(parse_message_type(&schema)?);
    let mut file = SerializedFileWriter::new(out, schema, Arc::new(properties))?;
    let mut group = file.next_row_group()?;
    let mut number = 0;
    while let Some(mut column) = group.next_column()? {
        if number == 0 {
            let names: Vec<ByteArray> = rows.iter().map(|row| row.touch.into()).collect();
            column.typed::<ByteArrayType>().write_batch(&names, None, None)?;
        } else if let Some((_, numbers)) = columns.get(number - 1) {
            column.typed::<DoubleType>().write_batch(numbers, None, None)?;
        } else {
            let touched: Vec<bool> = rows.iter().map(|row| row.touched).collect();
            column.typed::<BoolType>().write_batch(&touched, None, None)?;
        }
        column.close()?;
        number += 1;
    }
    group.close()?;
    file.close()?;
    Ok(())
}

fn mcap(out: impl Write + Seek, joints: &[String], rows: &[TorqueRow<'_>]) -> io::Result<()> {
    let mut bag = TorqueWriter::new(out, joints.to_vec())?;
    let mut touch = None;
    for row in rows {
        if touch != Some(row.touch) {
            touch = Some(row.touch);
            bag.touch(row.touch)?;
        }
        bag.torque((row.time_s, row.q, row.torque), row.std, row.touched)?;
        if let Some(WrenchRow { link, in_link, .. }) = &row.wrench {
            bag.wrench(row.time_s, link, in_link)?;
        }
    }
    bag.finish()
}
