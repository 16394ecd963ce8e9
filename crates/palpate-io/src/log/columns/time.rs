//! The time in a table: one column, in a unit that its name or the size of its numbers tells, or one of seconds
//! and one of nanoseconds.

use std::sync::LazyLock;

use regex::Regex;

use super::base;

/// Where the time of a row stands.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::log) struct Time {
    place: usize,
    /// The column of nanoseconds that are added.
    nanoseconds: Option<usize>,
    /// Seconds in a unit, if the name says it.
    unit_s: Option<f64>,
}

/// Names of a time, the first pattern counting most, without the unit and in lower case.
static TIMES: LazyLock<Vec<Regex>> = LazyLock::new(|| {
    let names = [
        r"(?:.*[./])?stamp",
        "time",
        "t",
        "(?:.*[./])?time_?stamp",
        "(?:__|%)time",
        "(?:controller|elapsed|host|record|robot|ros|sample|sim|system|unix|wall)[_ ]time",
    ];
    let pattern = |name| Regex::new(&format!("^{name}$")).expect("names fit a pattern");
    names.into_iter().map(pattern).collect()
});

/// Endings of a name that say its unit.
const UNITS: &[(f64, &[&str])] = &[
    (1.0, &["seconds", "secs", "sec", "s"]),
    (1e-3, &["milliseconds", "millis", "msec", "ms"]),
    (1e-6, &["microseconds", "micros", "usec", "us"]),
    (1e-9, NANOSECONDS),
];
const NANOSECONDS: &[&str] =
    &["nanoseconds", "nanosecs", "nanosec", "nanos", "nsecs", "nsec", "ns"];

/// Names of the time, ms, and of another column in what libfranka's `logToCSV` writes, now and in older versions.
const LIBFRANKA: [[&str; 2]; 2] = [["time", "success_rate"], ["duration", "success rate"]];

impl Time {
    /// The column, or the two columns, that are called so. A message's stamp counts more than when it was written.
    pub(super) fn find(header: &[String]) -> Option<Self> {
        let names: Vec<String> =
            header.iter().map(|name| name.trim().to_ascii_lowercase()).collect();
        let in_two = in_two(&names);
        let stamp = in_two.clone().filter(|time| names[time.place].contains("stamp"));
        of_libfranka(header).or(stamp).or_else(|| in_one(&names)).or(in_two)
    }

    /// The column at this place, which the user or the format names.
    pub(in crate::log) fn at(place: usize, header: &[String]) -> Self {
        let unit_s = of_libfranka(header)
            .filter(|time| time.place == place)
            .map_or_else(|| named_unit(&header[place].to_ascii_lowercase()).1, |time| time.unit_s);
        Self { place, nanoseconds: None, unit_s }
    }

    /// Its columns.
    pub(super) fn places(&self) -> impl Iterator<Item = usize> + Clone + use<> {
        [self.place].into_iter().chain(self.nanoseconds)
    }

    /// The time of a row of which `number` is the number in a column, s.
    pub(in crate::log) fn seconds<E>(
        &self,
        mut number: impl FnMut(usize) -> Result<f64, E>,
    ) -> Result<f64, E> {
        let time = number(self.place)?;
        let nanoseconds = self.nanoseconds.map(number).transpose()?.unwrap_or(0.0);
        Ok(time * self.unit_s.unwrap_or_else(|| unit_of(time)) + 1e-9 * nanoseconds)
    }
}

/// Seconds in the unit of a time that does not say it. From 10¹¹ on it counts from 1970 in ms, µs or ns: as seconds
/// it would be after the year 5000, as ms it is after 1973.
fn unit_of(time: f64) -> f64 {
    match time.abs() {
        size if size >= 1e17 => 1e-9,
        size if size >= 1e14 => 1e-6,
        size if size >= 1e11 => 1e-3,
        _ => 1.0,
    }
}

/// The time in what libfranka writes.
fn of_libfranka(header: &[String]) -> Option<Time> {
    let place = |wanted: &str| header.iter().position(|name| name.trim() == wanted);
    let place = LIBFRANKA.iter().find_map(|[time, other]| place(other).and(place(time)))?;
    Some(Time { place, nanoseconds: None, unit_s: Some(1e-3) })
}

/// The column whose name is one of the [`TIMES`].
fn in_one(names: &[String]) -> Option<Time> {
    let plain: Vec<(&str, Option<f64>)> = names.iter().map(|name| named_unit(name)).collect();
    let called = |pattern: &Regex| plain.iter().position(|(name, _)| pattern.is_match(name));
    let place = TIMES.iter().find_map(called)?;
    Some(Time { place, nanoseconds: None, unit_s: plain[place].1 })
}

/// Two columns whose names differ in `sec` and `nanosec`.
fn in_two(names: &[String]) -> Option<Time> {
    let seconds = UNITS[0].1;
    let stem = |name: &'_ String| {
        NANOSECONDS.iter().find_map(|unit| Some(name.strip_suffix(unit)?.to_owned()))
    };
    names.iter().enumerate().find_map(|(place, name)| {
        let stem = stem(name)?;
        let of_seconds =
            |other: &String| other.strip_prefix(&stem).is_some_and(|unit| seconds.contains(&unit));
        let nanoseconds = Some(place);
        Some(Time { place: names.iter().position(of_seconds)?, nanoseconds, unit_s: Some(1.0) })
    })
}

/// A name without its unit, and seconds in that unit, if it says one: `time [ms]`, `record_time_nsec`.
fn named_unit(name: &str) -> (&str, Option<f64>) {
    let plain = base(name);
    let bracket = name.trim()[plain.len()..].trim_matches(|c: char| !c.is_ascii_alphanumeric());
    let (rest, unit) = match (bracket, plain.rsplit_once(['_', ' '])) {
        ("", Some((rest, unit))) => (rest, unit),
        (bracket, _) => (plain, bracket),
    };
    let said = UNITS.iter().find(|(_, names)| names.contains(&unit));
    said.map_or((plain, None), |(unit_s, _)| (rest, Some(*unit_s)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(header: &str) -> Option<Time> {
        let header: Vec<String> = header.split(',').map(str::to_owned).collect();
        Time::find(&header)
    }

    /// The time of a row of which the columns hold these numbers.
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
            ("time_ms,q1,tau1", 2e-3),
            ("timestamp (us),q1", 2e-6),
            ("record_time_nsec,q1", 2e-9),
            ("time,success_rate,state.q[0],state.tau_J[0]", 2e-3),
            ("duration, success rate, q[0],tau_J[0],sent commands,q_d[0]", 2e-3),
        ] {
            assert_eq!(seconds(header, &[2.0, 7.0]), Some(wanted), "{header}");
        }
        // Another's duration is no time, nor are nanoseconds by themselves or a time constant.
        for header in ["duration,q1", "stamp.nsecs,q1", "time_constant,q1", "cycle_time,q1"] {
            assert_eq!(find(header), None, "{header}");
        }
    }

    #[test]
    fn since_1970_its_unit_is_told_by_its_size() {
        for unit_s in [1.0, 1e-3, 1e-6, 1e-9] {
            for header in ["timestamp,q1", "%time,q1", "field.header.stamp,q1"] {
                let found = seconds(header, &[1.7e9 / unit_s]).unwrap();
                assert!((found - 1.7e9).abs() < 1e-6, "{header}, {unit_s}: {found}");
            }
        }
    }

    #[test]
    fn seconds_and_nanoseconds_are_one_time() {
        for header in [
            "sec,nanosec,q1",
            "tsec,tnsec,mp1",
            "ZeitInSec,ZeitInNanoSec,axisQMsr_LBR_iiwa_7_R800_1[0]",
            "header.stamp.sec,header.stamp.nanosec,position[0]",
            "header.stamp.secs,header.stamp.nsecs,Time,position_0",
        ] {
            assert_eq!(seconds(header, &[3.0, 5e8, 9.0]), Some(3.5), "{header}");
        }
        // When the library says a time of its own, its halves are the controller's clock.
        assert_eq!(seconds("time,record_time_nsec,tsec,tnsec", &[1.0, 2.0, 3.0, 4.0]), Some(1.0));
    }
}
