//! Time in a table: one column, whose unit follows from its name or the size of its numbers; or a column of seconds and
//! a column of nanoseconds.

use std::sync::LazyLock;

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use regex::Regex;

use crate::log::options::TimeUnit;

/// The columns of the time, and its unit.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::log) struct Time {
    place: usize,
    /// Column of nanoseconds that are added to the seconds in `place`.
    nanoseconds: Option<usize>,
    /// Ticks of the time per second; `None` until they are known.
    per_s: Option<f64>,
    /// Whether the unit was guessed from the size of the first number.
    is_guessed: bool,
}

/// Names of a time in lower case, without the unit; earlier patterns have priority.
static TIMES: LazyLock<Vec<Regex>> = LazyLock::new(|| {
    let names = [
        r"(?:.*[./])?stamp",
        "times?",
        "t",
        r"(?:.*[./])?time_?stamps?",
        "(?:__|%)time",
        "(?:controller|elapsed|host|record|robot|ros|sample|sim|system|unix|wall)[_ ]time",
    ];
    names.into_iter().map(|name| regex(&format!("^{name}$"))).collect()
});
/// A name, with a unit after it, if there is one.
static WITH_UNIT: LazyLock<Regex> = LazyLock::new(|| {
    let units: Vec<String> = UNITS.iter().map(|(_, names)| names.join("|")).collect();
    let units = units.join("|");
    regex(&format!("^(?<name>.*?)(?:[^a-z0-9µμ]+(?:in )?(?<unit>{units})[^a-z0-9µμ]*)?$"))
});

fn regex(pattern: &str) -> Regex {
    Regex::new(pattern).expect("names fit a pattern")
}

/// Units of time, per second, with their names.
const UNITS: &[(f64, &[&str])] = &[
    (1.0, &["seconds", "secs", "sec", "s"]),
    (1e3, &["milliseconds", "millis", "msec", "ms"]),
    (1e6, &["microseconds", "micros", "usec", "us", "µs", "μs"]),
    (1e9, NANOSECONDS),
];
const NANOSECONDS: &[&str] = &[
    "nanoseconds",
    "nano_seconds",
    "nanosecs",
    "nano_secs",
    "nanosec",
    "nano_sec",
    "nanos",
    "nsecs",
    "nsec",
    "ns",
];
/// Range in which a time without a unit is taken for a Unix time, s: 1998 to 2096.
const SINCE_1970_S: std::ops::RangeInclusive<f64> = 9e8..=4e9;

/// Names of the time column, ms, and of a second column, by which tables of libfranka's `logToCSV` are recognised: of
/// newer and of older versions.
const LIBFRANKA: [[&str; 2]; 2] = [["time", "success_rate"], ["duration", "success rate"]];

impl Time {
    /// Finds the column, or the two columns, of the time. The stamp of a message has priority over the time of
    /// recording, but only if it belongs to `topic`, the topic of the positions.
    pub(super) fn find(header: &[String], topic: &str) -> Option<Self> {
        let topic = topic.to_lowercase();
        let of_topic = |name: &String| {
            let name = name.trim().to_lowercase();
            if !name.contains('/') || name.starts_with(&topic) { name } else { String::new() }
        };
        let names: Vec<String> = header.iter().map(of_topic).collect();
        let in_one = || {
            let time = Self::in_one(&names)?;
            // `rostopic echo -p` writes nanoseconds.
            let is_of_rostopic = names.iter().any(|name| name.starts_with("field."));
            let per_s = time.per_s.or(is_of_rostopic.then_some(1e9));
            Some(Self { per_s, ..time })
        };
        of_libfranka(header).or_else(|| in_two(&names)).or_else(in_one)
    }

    /// Finds a column by a known name of the time; `names` are in lower case.
    pub(in crate::log) fn in_one(names: &[String]) -> Option<Self> {
        let plain: Vec<(&str, Option<f64>)> = names.iter().map(|name| parted(name)).collect();
        let called = |pattern: &Regex| plain.iter().position(|(name, _)| pattern.is_match(name));
        let place = TIMES.iter().find_map(called)?;
        Some(Self { place, nanoseconds: None, per_s: plain[place].1, is_guessed: false })
    }

    /// The time in a given column, with an optional column of nanoseconds; the unit follows from the name of the
    /// column.
    pub(in crate::log) fn at(place: usize, nanoseconds: Option<usize>, header: &[String]) -> Self {
        let said = || parted(&header[place].trim().to_lowercase()).1;
        let of_libfranka = of_libfranka(header).filter(|time| time.place == place);
        let per_s = of_libfranka.map_or_else(said, |time| time.per_s);
        Self { place, nanoseconds, per_s, is_guessed: false }
    }

    /// The same columns in a given unit, if there is one, whatever their names say.
    pub(in crate::log) fn in_unit(self, given: Option<TimeUnit>) -> Self {
        Self { per_s: given.map(TimeUnit::per_s).or(self.per_s), ..self }
    }

    /// Ticks per second, as guessed from the size of the first number; `None` if the unit is known.
    pub(in crate::log) fn guessed_ticks_per_s(&self) -> Option<f64> {
        self.per_s.filter(|_| self.is_guessed)
    }

    /// Indices of its columns.
    pub(in crate::log) fn places(&self) -> impl Iterator<Item = usize> + Clone + use<> {
        [self.place].into_iter().chain(self.nanoseconds)
    }

    /// The time of a row whose time is a date, s since 1970; `None` for a number. `cell` returns the text of a column.
    pub(in crate::log) fn of_date<'a>(&self, cell: impl Fn(usize) -> &'a str) -> Option<f64> {
        date_s(cell(self.place))
    }

    /// The time of a row, s; `number` reads a column of the row. If the name contains no unit, the first row decides
    /// it.
    pub(in crate::log) fn seconds<E>(
        &mut self,
        mut number: impl FnMut(usize) -> Result<f64, E>,
    ) -> Result<f64, E> {
        let time = number(self.place)?;
        let Some(place) = self.nanoseconds else {
            self.is_guessed |= self.per_s.is_none();
            let per_s = *self.per_s.get_or_insert_with(|| unit_of(time));
            return Ok(time / per_s);
        };
        let nanoseconds = number(place)?;
        // Either column may contain the whole time, in its own unit.
        Ok(match (time.fract() == 0.0, nanoseconds < 1e9) {
            (true, true) => time + 1e-9 * nanoseconds,
            (true, false) => 1e-9 * nanoseconds,
            (false, _) => time,
        })
    }
}

/// A date with a time of day as seconds since 1970, in UTC if there is no time zone. `None` for other text and numbers.
pub(in crate::log) fn date_s(text: &str) -> Option<f64> {
    if !text.contains(':') {
        return None;
    }
    let in_utc = || text.parse::<DateTime>().ok()?.to_zoned(TimeZone::UTC).ok();
    let moment = text.parse::<Timestamp>().ok();
    let moment = moment.or_else(|| in_utc().map(|moment| moment.timestamp()));
    moment.map(|moment| moment.as_duration().as_secs_f64())
}

/// Guesses the ticks per second of a time: ms, µs or ns if the time is then within [`SINCE_1970_S`], else s.
fn unit_of(time: f64) -> f64 {
    let is_now = |per_s: &f64| SINCE_1970_S.contains(&(time / per_s));
    [1e3, 1e6, 1e9].into_iter().find(is_now).unwrap_or(1.0)
}

/// The time in a table of libfranka; `None` for other tables.
fn of_libfranka(header: &[String]) -> Option<Time> {
    let place = |wanted: &str| header.iter().position(|name| name.trim() == wanted);
    let place = LIBFRANKA.iter().find_map(|[time, other]| place(other).and(place(time)))?;
    Some(Time { place, nanoseconds: None, per_s: Some(1e3), is_guessed: false })
}

/// Two columns whose names differ only in `sec` and `nanosec`; names with `stamp` have priority.
fn in_two(names: &[String]) -> Option<Time> {
    let of_place = |(place, name): (usize, &String)| {
        let stem = NANOSECONDS.iter().find_map(|unit| name.strip_suffix(unit))?;
        let is_of_seconds = |other: &String| {
            other.strip_prefix(stem).is_some_and(|unit| UNITS[0].1.contains(&unit))
        };
        let seconds = names.iter().position(is_of_seconds)?;
        let (nanoseconds, per_s) = (Some(place), Some(1.0));
        Some(Time { place: seconds, nanoseconds, per_s, is_guessed: false })
    };
    let mut found: Vec<Time> = names.iter().enumerate().filter_map(of_place).collect();
    found.sort_by_key(|time| !names[time.place].contains("stamp"));
    found.into_iter().next()
}

/// Splits a name in lower case, such as `time [ms]` or `record_time_nsec`, into the name and its unit, per second, if
/// any.
fn parted(name: &str) -> (&str, Option<f64>) {
    let Some(found) = WITH_UNIT.captures(name) else { return (name, None) };
    let unit = found.name("unit").map(|unit| unit.as_str());
    let said = UNITS.iter().find(|(_, names)| unit.is_some_and(|unit| names.contains(&unit)));
    (found.name("name").map_or(name, |name| name.as_str()), said.map(|(per_s, _)| *per_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_with_a_time_of_day_is_a_time_and_a_number_is_no_date() {
        let noon_s = 1_714_564_800.25; // `date -u -d "2024-05-01 12:00:00.25" +%s.%N`
        for text in [
            "2024-05-01 12:00:00.25",
            "2024-05-01T12:00:00.250000",
            "2024-05-01T12:00:00.25Z",
            "2024-05-01 14:00:00.25+02:00",
            "2024-05-01 12:00:00.250000+00:00",
        ] {
            assert!((date_s(text).unwrap() - noon_s).abs() < 1e-6, "{text}");
        }
        for text in
            ["20240501", "2024-05-01", "1714564800", "1.5", "", "12 o'clock", "2024-05-01 12:00:61"]
        {
            assert_eq!(date_s(text), None, "{text}");
        }
    }

    fn find(header: &str) -> Option<Time> {
        let header: Vec<String> = header.split(',').map(str::to_owned).collect();
        Time::find(&header, "/js/")
    }

    /// The time, s, of a row with these numbers.
    fn seconds(header: &str, row: &[f64]) -> Option<f64> {
        find(header)?.seconds(|place| Ok::<_, ()>(row[place])).ok()
    }

    #[test]
    fn its_unit_is_what_the_name_says_or_libfranka_wrote() {
        for (header, wanted) in [
            ("time,q1,tau1", 2.0),
            ("Time [s],q1,tau1", 2.0),
            ("host_time_s,q1", 2.0),
            ("Time [ms],q1,tau1", 2e-3),
            ("time (in ms),q1,tau1", 2e-3),
            ("time_ms,q1,tau1", 2e-3),
            ("timestamp (us),q1", 2e-6),
            ("Time [µs],q1", 2e-6),
            ("record_time_nsec,q1", 2e-9),
            ("time,success_rate,state.q[0],state.tau_J[0]", 2e-3),
            ("duration, success rate, q[0],tau_J[0],sent commands,q_d[0]", 2e-3),
            ("%time,field.header.seq,field.q0", 2e-9),
        ] {
            assert_eq!(seconds(header, &[2.0, 7.0]), Some(wanted), "{header}");
        }
        let mut clock = Time::at(0, None, &["t/ms".to_owned()]);
        assert_eq!(clock.seconds(|_| Ok::<_, ()>(2.0)), Ok(2e-3));
        // Names that are not the time: `duration` of other programs, the time of a cycle, other units.
        for header in [
            "duration,q1",
            "stamp_of_nothing,q1",
            "cycle_time,q1",
            "Time (min),q1",
            "T [°C],q1",
            "T_deg,q1",
        ] {
            assert_eq!(find(header), None, "{header}");
        }
    }

    #[test]
    fn a_stamp_counts_if_it_is_of_the_same_topic() {
        let header = "__time,/camera/header/stamp,/js/header/stamp,/js/position[0]";
        assert_eq!(seconds(header, &[1.0, 2.0, 3.0]), Some(3.0));
        assert_eq!(seconds("__time,/camera/header/stamp", &[1.0, 2.0]), Some(1.0));
    }

    #[test]
    fn since_1970_its_unit_follows_from_its_size_in_the_first_row() {
        for per_s in [1.0, 1e3, 1e6, 1e9] {
            for header in ["timestamp,q1", "stamp,q1"] {
                let found = seconds(header, &[1.7e9 * per_s]).unwrap();
                assert!((found - 1.7e9).abs() < 1e-6, "{header}, {per_s}: {found}");
            }
        }
        let mut since_start = find("time").unwrap();
        for time in [0.0, 1.7e12] {
            assert_eq!(since_start.seconds(|_| Ok::<_, ()>(time)), Ok(time));
        }
    }

    #[test]
    fn seconds_and_nanoseconds_are_one_time() {
        for header in [
            "sec,nanosec,q1",
            "tsec,tnsec,mp1",
            "time_sec,time_nsec,q1",
            "ZeitInSec,ZeitInNanoSec,axisQMsr_LBR_iiwa_7_R800_1[0]",
            "time_stamp_sec,time_stamp_nano_sec,measured_joint_position_0",
            "time_stamp_secs,time_stamp_nano_secs,q1",
            "sec,nano_secs,q1",
            "header.stamp.sec,header.stamp.nanosec,position[0]",
            "header.stamp.secs,header.stamp.nsecs,Time,position_0",
            "/js/stamp/sec,/js/stamp/nanosec,/camera/stamp/sec,/camera/stamp/nanosec",
        ] {
            assert_eq!(seconds(header, &[3.0, 5e8, 9.0, 9.0]), Some(3.5), "{header}");
        }
        // Both columns may contain the whole time.
        for (s, ns, wanted) in [(0.5, 5e8, 0.5), (1.0, 1e9, 1.0), (1.7e9, 1.7e18, 1.7e9)] {
            assert_eq!(seconds("timestamp_s,timestamp_ns", &[s, ns]), Some(wanted));
        }
    }
}
