//! Counts of the points and cells that touches displace, the same for `map`, `evaluate` and
//! `inspect`.

use palpate::Lattice;
use serde::Serialize;

use crate::settings::corners;

/// Number of points that the arm touches, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct ContactCounts {
    frames: u64,
    /// Number of touched points in each frame with contact.
    contacts: Vec<usize>,
}

/// The figures of [`ContactCounts`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ContactFigures {
    /// Number of frames in the log.
    pub frames: u64,
    /// Frames in which the arm touches points of the lattice.
    pub frames_in_contact: u64,
    /// Median number of touched points, over the frames with contact.
    pub contacts_median: usize,
    /// Number of cells that are touched after the tare.
    pub cells_touched: usize,
}

impl ContactCounts {
    /// Adds a frame with its number of touched points.
    pub fn add(&mut self, contacts: usize) {
        self.frames += 1;
        if contacts > 0 {
            self.contacts.push(contacts);
        }
    }

    /// Adds the frames of another touch.
    pub fn join(&mut self, other: &Self) {
        self.frames += other.frames;
        self.contacts.extend(&other.contacts);
    }

    /// Number of frames with contact.
    pub fn frames_in_contact(&self) -> u64 {
        self.contacts.len() as u64
    }

    /// Median number of touched points, over the frames with contact.
    pub fn contacts_median(&self) -> usize {
        let mut contacts = self.contacts.clone();
        let middle = contacts.len() / 2;
        if contacts.is_empty() { 0 } else { *contacts.select_nth_unstable(middle).1 }
    }

    /// The figures, with the number of touched cells.
    pub fn figures(&self, cells_touched: usize) -> ContactFigures {
        ContactFigures {
            frames: self.frames,
            frames_in_contact: self.frames_in_contact(),
            contacts_median: self.contacts_median(),
            cells_touched,
        }
    }

    /// A message if there are frames and none of them touches the lattice.
    pub fn nothing(&self, lattice: &Lattice) -> Option<String> {
        let [low_m, high_m] = <[_; 2]>::from(corners(lattice)).map(point);
        let nothing = self.frames > 0 && self.contacts.is_empty();
        nothing.then(|| {
            format!(
                "0 of {} frames touch the lattice, whose box is {low_m} .. {high_m} m: there is \
                 nothing to learn",
                self.frames
            )
        })
    }
}

impl FromIterator<usize> for ContactCounts {
    fn from_iter<I: IntoIterator<Item = usize>>(contacts: I) -> Self {
        let mut touched = Self::default();
        contacts.into_iter().for_each(|contacts| touched.add(contacts));
        touched
    }
}

/// A point in words, m.
pub fn point([x, y, z]: [f64; 3]) -> String {
    format!("({x:.3}, {y:.3}, {z:.3})")
}

/// The lowest and the highest corner of a box, given two opposite ones.
pub(crate) fn low_and_high([a, b]: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
    let corner = |of: fn(f64, f64) -> f64| [0, 1, 2].map(|axis| of(a[axis], b[axis]));
    [corner(f64::min), corner(f64::max)]
}
