//! What touches displace of the lattice, counted in one way by `map`, `evaluate` and `inspect`.

use palpate::Lattice;
use serde::Serialize;

use crate::settings::corners;

/// How many points the arm touches, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct Touched {
    frames: u64,
    /// Points touched in each frame that touches any.
    contacts: Vec<usize>,
}

/// [`Touched`] in figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct TouchedFigures {
    /// Frames in the log.
    pub frames: u64,
    /// Frames in which the arm touches points of the lattice.
    pub frames_in_contact: u64,
    /// Median points touched, over the frames that touch any.
    pub contacts_median: usize,
    /// Cells that are touched in the frames after the tare.
    pub cells_touched: usize,
}

impl Touched {
    /// Adds a frame that touches so many points.
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

    /// Frames that touch any point.
    pub fn frames_in_contact(&self) -> u64 {
        self.contacts.len() as u64
    }

    /// Median points touched, over the frames that touch any.
    pub fn contacts_median(&self) -> usize {
        let mut contacts = self.contacts.clone();
        let middle = contacts.len() / 2;
        if contacts.is_empty() { 0 } else { *contacts.select_nth_unstable(middle).1 }
    }

    /// The figures of a log that touches so many cells.
    pub fn figures(&self, cells_touched: usize) -> TouchedFigures {
        TouchedFigures {
            frames: self.frames,
            frames_in_contact: self.frames_in_contact(),
            contacts_median: self.contacts_median(),
            cells_touched,
        }
    }

    /// What is wrong if there are frames and none of them touches the lattice.
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

impl FromIterator<usize> for Touched {
    fn from_iter<I: IntoIterator<Item = usize>>(contacts: I) -> Self {
        let mut touched = Self::default();
        contacts.into_iter().for_each(|contacts| touched.add(contacts));
        touched
    }
}

/// A place in words.
pub fn point([x, y, z]: [f64; 3]) -> String {
    format!("({x:.3}, {y:.3}, {z:.3})")
}

/// The lowest and the highest corner of a box, given two opposite ones.
pub(crate) fn low_and_high([a, b]: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
    let corner = |of: fn(f64, f64) -> f64| [0, 1, 2].map(|axis| of(a[axis], b[axis]));
    [corner(f64::min), corner(f64::max)]
}
