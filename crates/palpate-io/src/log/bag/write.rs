//! Writes touches and stiff points as MCAP with the profile `ros2`, which the tools of ROS 2 read.
//!
//! | topic            | type                      | one message                             |
//! |------------------|---------------------------|-----------------------------------------|
//! | `/joint_states`  | `sensor_msgs/JointState`  | a sample: positions, torques as efforts |
//! | `/palpate/touch` | `std_msgs/String`         | before the first sample of each touch   |
//! | `/palpate/field` | `sensor_msgs/PointCloud2` | a field: `x y z K K_std`, 32-bit floats |
//!
//! The header of a sample has its time, to the nanosecond. The clock may restart with each touch, but
//! the times of recording in the bag never decrease from touch to touch. Samples without a time have
//! the time 0 in the header, and are recorded a millisecond apart.

use std::collections::BTreeMap;
use std::io::{self, Seek, Write};

use ::mcap::records::MessageHeader;
use ::mcap::{McapError, WriteOptions, Writer};
use palpate::Sample;
use re_cdr::{CdrWriter, LittleEndian};
use serde::Deserialize;

use super::reading::{HEADER, joint_state};
use super::topic::TOUCH_TOPIC;
use crate::field::FieldFile;
use crate::log::write::TouchWriter;

/// Compression of the chunks of a bag.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Compression {
    /// Zstandard: smaller files. Needs the feature `formats`.
    #[cfg_attr(feature = "formats", default)]
    Zstd,
    /// LZ4: faster. Needs the feature `formats`.
    Lz4,
    /// No compression.
    #[cfg_attr(not(feature = "formats"), default)]
    None,
}

/// Smallest interval between the recording times of one touch and the next, ns.
const PAUSE_NS: i64 = 1_000_000_000;
/// Interval between the recording times of samples without a time, ns.
const PERIOD_NS: i64 = 1_000_000;

const POINT_CLOUD: &str = "std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
";
/// Definition of the inner type of a point cloud other than its header.
const POINT_FIELD: &str =
    "================================================================================
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
";

const ARRAY: &str = "MultiArrayLayout layout
float64[] data
";
const ARRAY_LAYOUT: &str =
    "================================================================================
MSG: std_msgs/MultiArrayLayout
MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
";

const WRENCH: &str = "std_msgs/Header header
geometry_msgs/Wrench wrench
";
const WRENCH_PARTS: &str =
    "================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
";

/// Writes a bag, message by message.
struct Bag<W: Write + Seek> {
    writer: Writer<W>,
    sequence: u32,
}

impl<W: Write + Seek> Bag<W> {
    fn new(out: W, compression: Compression) -> io::Result<Self> {
        let compression = match compression {
            #[cfg(feature = "formats")]
            Compression::Zstd => Some(::mcap::Compression::Zstd),
            #[cfg(feature = "formats")]
            Compression::Lz4 => Some(::mcap::Compression::Lz4),
            #[cfg(not(feature = "formats"))]
            Compression::Zstd | Compression::Lz4 => {
                return Err(io::Error::other(crate::not_built("compression of bags")));
            }
            Compression::None => None,
        };
        let library = concat!("palpate ", env!("CARGO_PKG_VERSION"));
        let options = WriteOptions::new().compression(compression).profile("ros2").library(library);
        Ok(Self { writer: options.create(out).map_err(other)?, sequence: 0 })
    }

    fn channel(&mut self, topic: &str, kind: &str, definition: &str) -> io::Result<u16> {
        let schema = self.writer.add_schema(kind, "ros2msg", definition.as_bytes());
        let schema = schema.map_err(other)?;
        self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).map_err(other)
    }

    fn put(&mut self, channel_id: u16, time_ns: i64, data: &[u8]) -> io::Result<()> {
        self.sequence = self.sequence.wrapping_add(1);
        let (sequence, log_time) = (self.sequence, time_ns.cast_unsigned());
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, data).map_err(other)
    }

    fn finish(mut self) -> io::Result<()> {
        self.writer.finish().map(|_| ()).map_err(other)
    }
}

/// Writes touches as a bag; the marker of a touch is written with its first sample.
pub struct BagWriter<W: Write + Seek> {
    bag: Bag<W>,
    joints: Vec<String>,
    samples: u16,
    markers: u16,
    /// Time of recording of the last message, ns.
    latest_ns: i64,
    /// Difference between the time of recording and the clock of the touch, ns; `None` before the
    /// first sample of the touch.
    shift_ns: Option<i64>,
    name: String,
}

impl<W: Write + Seek> BagWriter<W> {
    /// Starts a bag for samples of these joints.
    ///
    /// # Errors
    ///
    /// If the first records cannot be written.
    pub fn new(out: W, joints: Vec<String>, compression: Compression) -> io::Result<Self> {
        Self::on("/joint_states", out, joints, compression)
    }

    fn on(topic: &str, out: W, joints: Vec<String>, compression: Compression) -> io::Result<Self> {
        let mut bag = Bag::new(out, compression)?;
        let samples = bag.channel(topic, "sensor_msgs/msg/JointState", &joint_state())?;
        let markers = bag.channel(TOUCH_TOPIC, "std_msgs/msg/String", "string data\n")?;
        let (name, shift_ns) = (String::new(), None);
        Ok(Self { bag, joints, samples, markers, latest_ns: 0, shift_ns, name })
    }

    fn joint_state(&self, time_ns: i64, sample: &Sample) -> Vec<u8> {
        message(|out| {
            header(out, time_ns, "");
            out.write_sequence_length(self.joints.len());
            self.joints.iter().for_each(|joint| out.write_string(joint));
            for values in [&sample.q[..], &[], &sample.tau[..]] {
                out.write_sequence_length(values.len());
                values.iter().for_each(|&value| out.write_f64(value));
            }
        })
    }
}

impl<W: Write + Seek> TouchWriter for BagWriter<W> {
    fn touch(&mut self, name: &str) -> io::Result<()> {
        name.clone_into(&mut self.name);
        self.shift_ns = None;
        Ok(())
    }

    fn sample(&mut self, sample: &Sample) -> io::Result<()> {
        let joints = self.joints.len();
        if sample.q.len() != joints || sample.tau.len() != joints {
            let (q, tau) = (sample.q.len(), sample.tau.len());
            let what = format!("a sample has {q} positions and {tau} torques for {joints} joints");
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        let time_ns = sample.time_s.map(nanoseconds).transpose()?;
        let first = self.shift_ns.is_none();
        let earliest = self.latest_ns + if first { PAUSE_NS } else { PERIOD_NS };
        let recorded_ns = match time_ns {
            // A touch keeps its own clock if it begins late enough after the previous touch.
            Some(time_ns) => {
                let shift_ns = *self.shift_ns.get_or_insert((earliest - time_ns).max(0));
                (time_ns + shift_ns).max(self.latest_ns)
            }
            None => {
                self.shift_ns = Some(0);
                earliest
            }
        };
        if first {
            let marker = message(|out| out.write_string(&self.name));
            self.bag.put(self.markers, recorded_ns, &marker)?;
        }
        self.latest_ns = recorded_ns;
        let message = self.joint_state(time_ns.unwrap_or(0), sample);
        self.bag.put(self.samples, recorded_ns, &message)
    }

    fn finish(self) -> io::Result<()> {
        self.bag.finish()
    }
}

/// Writes external torques with their standard deviations, one sample after another: [`crate::torques`].
pub(crate) struct TorqueWriter<W: Write + Seek> {
    torques: BagWriter<W>,
    stds: u16,
    touched: u16,
    /// The channel of wrenches, once there is one.
    wrenches: Option<u16>,
}

impl<W: Write + Seek> TorqueWriter<W> {
    /// Starts a bag for torques of these joints.
    ///
    /// # Errors
    ///
    /// If the first records cannot be written.
    pub(crate) fn new(out: W, joints: Vec<String>) -> io::Result<Self> {
        let topic = "/palpate/external_torque";
        let mut torques = BagWriter::on(topic, out, joints, Compression::default())?;
        let array = [ARRAY, ARRAY_LAYOUT].concat();
        let kind = "std_msgs/msg/Float64MultiArray";
        let stds = torques.bag.channel("/palpate/external_torque_std", kind, &array)?;
        let touched =
            torques.bag.channel("/palpate/touched", "std_msgs/msg/Bool", "bool data\n")?;
        Ok(Self { torques, stds, touched, wrenches: None })
    }

    /// Starts a touch.
    ///
    /// # Errors
    ///
    /// As [`TouchWriter::touch`].
    pub(crate) fn touch(&mut self, name: &str) -> io::Result<()> {
        self.torques.touch(name)
    }

    /// Writes a sample: time, positions and external torques; their standard deviations, N·m; whether a contact is
    /// detected.
    ///
    /// # Errors
    ///
    /// As [`TouchWriter::sample`].
    pub(crate) fn torque(
        &mut self,
        (time_s, q, torque): (Option<f64>, &[f64], &[f64]),
        std: &[f64],
        touched: bool,
    ) -> io::Result<()> {
        self.torques.sample(&Sample::new(time_s, q.to_vec(), torque.to_vec()))?;
        let (bag, now_ns) = (&mut self.torques.bag, self.torques.latest_ns);
        let stds = message(|out| {
            out.write_sequence_length(0); // dimensions
            out.write_u32(0); // offset of the data
            out.write_sequence_length(std.len());
            std.iter().for_each(|&std| out.write_f64(std));
        });
        bag.put(self.stds, now_ns, &stds)?;
        bag.put(self.touched, now_ns, &message(|out| out.write_bool(touched)))
    }

    /// Writes the wrench at the last sample, N and N·m, about the origin of a link and in its frame.
    ///
    /// # Errors
    ///
    /// As [`TouchWriter::sample`].
    pub(crate) fn wrench(
        &mut self,
        time_s: Option<f64>,
        link: &str,
        wrench: &[f64; 6],
    ) -> io::Result<()> {
        let time_ns = time_s.map(nanoseconds).transpose()?.unwrap_or(0);
        let (bag, now_ns) = (&mut self.torques.bag, self.torques.latest_ns);
        let channel = match self.wrenches {
            Some(channel) => channel,
            None => {
                let definition = [WRENCH, HEADER, WRENCH_PARTS].concat();
                let kind = "geometry_msgs/msg/WrenchStamped";
                *self.wrenches.insert(bag.channel("/palpate/wrench", kind, &definition)?)
            }
        };
        let data = message(|out| {
            header(out, time_ns, link);
            wrench.iter().for_each(|&number| out.write_f64(number));
        });
        bag.put(channel, now_ns, &data)
    }

    /// Ends the bag.
    ///
    /// # Errors
    ///
    /// If the end cannot be written.
    pub(crate) fn finish(self) -> io::Result<()> {
        self.torques.finish()
    }
}

/// Writes a field as one cloud of points, in the frame of the robot's base.
///
/// # Errors
///
/// If it cannot be written, or has too many points for one message.
pub fn write_field(
    out: impl Write + Seek,
    field: &FieldFile,
    frame: &str,
    compression: Compression,
) -> io::Result<()> {
    let columns: &[&str] =
        &["x", "y", "z", "K", "K_std"][..if field.std.is_some() { 5 } else { 4 }];
    let step = 4 * columns.len();
    let too_many = || {
        io::Error::new(
            io::ErrorKind::InvalidData,
            "the field has too many points for a point cloud message",
        )
    };
    let points = u32::try_from(field.points.len()).map_err(|_| too_many())?;
    let bytes = u32::try_from(field.points.len() * step).map_err(|_| too_many())?;
    let data = message(|out| {
        header(out, 0, frame);
        out.write_u32(1);
        out.write_u32(points);
        out.write_sequence_length(columns.len());
        for (place, name) in columns.iter().enumerate() {
            out.write_string(name);
            out.write_u32(4 * place as u32);
            out.write_u8(7); // 32-bit floats
            out.write_u32(1);
        }
        out.write_bool(false);
        out.write_u32(step as u32);
        out.write_u32(bytes);
        out.write_u32(bytes);
        for (row, point) in field.points.iter().enumerate() {
            let std = field.std.as_ref().map(|std| std[row]);
            let numbers = point.iter().copied().chain([field.stiffness[row]]).chain(std);
            numbers.for_each(|number| out.write_f32(number as f32));
        }
        out.write_bool(true);
    });
    let mut bag = Bag::new(out, compression)?;
    let kind = "sensor_msgs/msg/PointCloud2";
    let definition = [POINT_CLOUD, HEADER, POINT_FIELD].concat();
    let cloud = bag.channel("/palpate/field", kind, &definition)?;
    bag.put(cloud, 0, &data)?;
    bag.finish()
}

/// A message in plain little-endian CDR, whose body `fill` writes.
fn message(fill: impl FnOnce(&mut CdrWriter<'_, LittleEndian>)) -> Vec<u8> {
    let mut body = Vec::new();
    fill(&mut CdrWriter::new(&mut body));
    [&[0, 1, 0, 0], &body[..]].concat()
}

fn header(out: &mut CdrWriter<'_, LittleEndian>, time_ns: i64, frame: &str) {
    let second = 1_000_000_000;
    out.write_i32(time_ns.div_euclid(second) as i32);
    out.write_u32(time_ns.rem_euclid(second) as u32);
    out.write_string(frame);
}

/// Converts a time to ns; an error if a header cannot represent it.
fn nanoseconds(time_s: f64) -> io::Result<i64> {
    if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&time_s) {
        let what = format!("the time {time_s} s is beyond what a header of ROS 2 can hold");
        return Err(io::Error::new(io::ErrorKind::InvalidData, what));
    }
    let whole = time_s.floor();
    Ok(whole as i64 * 1_000_000_000 + ((time_s - whole) * 1e9).round() as i64)
}

fn other(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
