//! Unit of the positions, from the names of their columns, and the given unit of times.

use super::super::options::{AngleUnit, CsvColumns, LogOptions};
use super::{Columns, Time};

impl Columns {
    /// As [`Self::in_unit`], for angles and times.
    pub(in crate::log) fn in_units(
        self,
        header: &[String],
        options: &LogOptions,
    ) -> Result<Self, String> {
        let time = self.time.clone().map(|time| time.in_unit(options.time_unit));
        Self { time, ..self }.in_unit(header, options.angle_unit)
    }

    /// Ticks per second of the times, if their unit was guessed from the size of the first one.
    pub(in crate::log) fn guessed_ticks_per_s(&self) -> Option<f64> {
        self.time.as_ref().and_then(Time::guessed_ticks_per_s)
    }

    /// Returns the columns, or an error if a name contradicts the given unit. Without a given unit, columns whose names
    /// say degrees are marked in `degrees`. The error is the end of a message to the user.
    fn in_unit(self, header: &[String], unit: Option<AngleUnit>) -> Result<Self, String> {
        let says = |place: usize, unit: AngleUnit| says(&header[place], unit);
        let Some(given) = unit else {
            let degrees = self.q.iter().map(|&place| says(place, AngleUnit::Deg)).collect();
            return Ok(Self { degrees, ..self });
        };
        let other = match given {
            AngleUnit::Rad => AngleUnit::Deg,
            AngleUnit::Deg => AngleUnit::Rad,
        };
        match self.q.iter().find(|&&place| says(place, other)) {
            None => Ok(self),
            Some(&place) => {
                let name = &header[place];
                Err(format!(
                    "column `{name}` contradicts the angle unit {given:?}; change one of them"
                ))
            }
        }
    }

    /// Converts positions to radians where the name of their column says degrees. The name of a single column applies
    /// to all positions: it may hold a list.
    pub(in crate::log) fn turn_degrees(&self, q: &mut [f64]) {
        let by_joint = self.degrees.iter().cycle().take(q.len());
        q.iter_mut()
            .zip(by_joint)
            .filter(|(_, degrees)| **degrees)
            .for_each(|(q, _)| *q = q.to_radians());
    }
}

impl CsvColumns {
    /// The unit in the name of a column of positions; degrees if the names of columns differ.
    pub fn angle_unit(&self) -> Option<AngleUnit> {
        [AngleUnit::Deg, AngleUnit::Rad]
            .into_iter()
            .find(|unit| self.q.iter().any(|name| says(name, *unit)))
    }
}

/// Whether the name of a column says that it is in this unit.
fn says(name: &str, unit: AngleUnit) -> bool {
    let words: &[&str] = match unit {
        AngleUnit::Deg => &["deg", "degree", "degrees", "°"],
        AngleUnit::Rad => &["rad", "radian", "radians"],
    };
    let name = name.trim().to_ascii_lowercase();
    let last = name.split(|c: char| !c.is_ascii_alphabetic()).next_back();
    words.iter().any(|word| {
        last == Some(word)
            || name.ends_with(&format!("[{word}]"))
            || name.ends_with(&format!("({word})"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_degrees_unless_a_unit_is_given_that_they_contradict() {
        let header = ["q1 [deg]", "q2 [m]", "tau1", "tau2"].map(str::to_owned);
        let columns = || Columns::find(&header, None).unwrap();
        let mut q = [180.0, 0.5];
        columns().in_unit(&header, None).unwrap().turn_degrees(&mut q);
        assert_eq!(q, [std::f64::consts::PI, 0.5]);
        columns().in_unit(&header, Some(AngleUnit::Deg)).unwrap().turn_degrees(&mut q);
        assert_eq!(q, [std::f64::consts::PI, 0.5], "which is done for all joints elsewhere");
        let error = columns().in_unit(&header, Some(AngleUnit::Rad)).unwrap_err();
        assert!(error.contains("`q1 [deg]` contradicts"), "{error}");
        let header = ["q1_rad", "tau1"].map(str::to_owned);
        let columns = Columns::find(&header, None).unwrap();
        assert!(columns.in_unit(&header, Some(AngleUnit::Deg)).is_err());
    }
}
