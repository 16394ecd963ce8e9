//! Values of settings that are not a single number, with their parsers.

use std::str::FromStr;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use palpate_io::log::CsvColumns;
use serde::de::IntoDeserializer;
use serde::de::value::{Error, StrDeserializer};
use serde::{Deserialize, Serialize};

/// A parser of values by their serde names, which help and shell completion list.
pub fn named<T>(words: &[&'static str]) -> impl TypedValueParser<Value = T> + use<T>
where
    T: for<'de> Deserialize<'de> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(words.iter().copied()).try_map(|word| {
        let word: StrDeserializer<'_, Error> = word.as_str().into_deserializer();
        T::deserialize(word)
    })
}

/// Parses a value that can be made from a string.
pub(super) fn from_word<T: TryFrom<String>>(text: &str) -> Result<T, T::Error> {
    text.to_owned().try_into()
}

/// Two numbers with a comma between them.
pub fn pair(text: &str) -> Result<[f64; 2], String> {
    several(text, "two numbers with a comma between, such as 0.1,2")
}

/// Three numbers with commas between them.
pub fn vector3(text: &str) -> Result<[f64; 3], String> {
    several(text, "three numbers with commas between, such as -1.2,0,0.5")
}

/// Three counts with commas between them.
pub(super) fn counts3(text: &str) -> Result<[u32; 3], String> {
    several(text, "three whole numbers with commas between, such as 200,200,100")
}

fn several<T: FromStr, const N: usize>(text: &str, wanted: &str) -> Result<[T; N], String> {
    let parts: Option<Vec<T>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    parts.and_then(|parts| parts.try_into().ok()).ok_or_else(|| format!("wanted {wanted}"))
}

/// Columns of a table: `q=a,b;tau=c,d;joints=e,f;time=t;touch=n`.
pub(super) fn columns(text: &str) -> Result<CsvColumns, String> {
    let mut columns = CsvColumns::default();
    for part in text.split(';') {
        let (key, value) = part.split_once('=').ok_or("wanted q=a,b;tau=c,d;time=t;touch=n")?;
        let names = || value.split(',').map(|name| name.trim().to_owned()).collect();
        match key.trim() {
            "q" => columns.q = names(),
            "tau" => columns.tau = names(),
            "joints" => columns.joints = Some(names()),
            "time" => columns.time = Some(value.trim().to_owned()),
            "touch" => columns.touch = Some(value.trim().to_owned()),
            other => return Err(format!("`{other}` is none of q, tau, joints, time and touch")),
        }
    }
    match (columns.q.len(), columns.tau.len()) {
        (n, m) if n == m && n > 0 => Ok(columns),
        (n, m) => Err(format!("{n} columns of q and {m} of tau; wanted one each for every joint")),
    }
}

/// A joint that stands still, and its position: `JOINT=POSITION`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct HeldJoint {
    /// Name of the joint.
    pub joint: String,
    /// Its position, rad or m.
    pub position: f64,
}

impl TryFrom<String> for HeldJoint {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let wanted =
            || format!("found `{text}`; wanted JOINT=POSITION, rad or m, such as finger=0.04");
        let (joint, position) = text.split_once('=').ok_or_else(wanted)?;
        let position: f64 = position.trim().parse().map_err(|_| wanted())?;
        let is_held = !joint.trim().is_empty() && position.is_finite();
        is_held.then(|| Self { joint: joint.trim().to_owned(), position }).ok_or_else(wanted)
    }
}

impl From<HeldJoint> for String {
    fn from(held: HeldJoint) -> Self {
        format!("{}={}", held.joint, held.position)
    }
}

/// Name of a joint in the log and in the URDF: `LOG=URDF`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RenamedJoint {
    /// Its name in the log.
    pub in_log: String,
    /// Its name in the URDF.
    pub in_urdf: String,
}

impl TryFrom<String> for RenamedJoint {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let names = text.split_once('=').map(|(log, urdf)| (log.trim(), urdf.trim()));
        match names {
            Some((in_log, in_urdf)) if !in_log.is_empty() && !in_urdf.is_empty() => {
                Ok(Self { in_log: in_log.to_owned(), in_urdf: in_urdf.to_owned() })
            }
            _ => {
                Err(format!("found `{text}`; wanted NAME_IN_LOG=NAME_IN_URDF, such as j1=joint_1"))
            }
        }
    }
}

impl From<RenamedJoint> for String {
    fn from(renamed: RenamedJoint) -> Self {
        format!("{}={}", renamed.in_log, renamed.in_urdf)
    }
}

/// A setting that is found from the data unless it is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "wanted `auto` or one of the values in the comment of this key (`palpate settings`)"
)]
pub enum OrAuto<T> {
    /// Found from the data.
    Auto(Auto),
    /// Given.
    Is(T),
}

/// The word for a setting that is found from the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Auto {
    /// `auto`.
    Auto,
}

impl<T> OrAuto<T> {
    /// To be found from the data.
    pub(crate) const AUTO: Self = Self::Auto(Auto::Auto);

    /// The given value; `None` if it is to be found from the data.
    pub fn given(self) -> Option<T> {
        match self {
            Self::Auto(_) => None,
            Self::Is(value) => Some(value),
        }
    }
}

/// Frames whose mean torque is the tare.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "toml::Value", into = "toml::Value")]
pub enum TareFrames {
    /// The contact-free start, found automatically.
    Auto,
    /// The first frames of each touch.
    First(u32),
}

const TARE_WANTED: &str = "wanted a number of frames above 0, or auto";

impl FromStr for TareFrames {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match (text, text.parse()) {
            ("auto", _) => Ok(Self::Auto),
            (_, Ok(frames)) if frames > 0 => Ok(Self::First(frames)),
            _ => Err(TARE_WANTED),
        }
    }
}

impl TryFrom<toml::Value> for TareFrames {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        text.parse().map_err(|wanted| format!("found {value}; {wanted}"))
    }
}

impl From<TareFrames> for toml::Value {
    fn from(frames: TareFrames) -> Self {
        match frames {
            TareFrames::Auto => "auto".into(),
            TareFrames::First(frames) => frames.into(),
        }
    }
}
