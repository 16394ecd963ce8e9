//! What is recorded for a viewer, sample by sample.
//!
//! | entity                      | holds                                                      |
//! |-----------------------------|------------------------------------------------------------|
//! | `world/arm/<link>`          | the link's shape once, its pose in every sample            |
//! | `world/contacts/at`         | where the drawn contacts are now, m                        |
//! | `world/contacts/displaced`  | arrows from each one's rest point to there, true to length |
//! | `world/field`               | the drawn cells, K, its deviation and touches by cell      |
//! | `world/body/…`              | `wood`, `leaves`, `blocks` of an elastic body, a line each |
//! | `torque/norm/…`             | norms of `measured`, `predicted` and `error`, N·m          |
//! | `torque/<joint>/…`          | `measured` and `predicted`, N·m                            |
//! | `contacts`                  | points touched, drawn or not                               |
//! | `colours`                   | which colour a stiffness has, in words                     |
//! | `about`, `touches`          | what this is; when which touch starts                      |
//!
//! Timelines are `sample`, the number of the sample, and `time`, s, where there is a clock.
//! [`crate::view_model`] decides what is drawn, `blueprint.rs` how it is laid out.
//!
//! Rerun gathers and sends on threads of its own. A viewer that cannot keep up slows the caller
//! down once 100 MB wait for it, so a caller that must not wait uses a thread of its own and drops
//! what does not fit.

use std::io::Write;
use std::time::{Duration, Instant};

use nalgebra::{DVector, Isometry3, Point3};
use palpate::unstable::{ElasticBody, SegmentKind};
use palpate::{Contacts, Field, Lattice};
use re_sdk::time::TimeCell;
use re_sdk::{AsComponents, RecordingStream, RecordingStreamBuilder, RecordingStreamError};
use re_sdk_types::archetypes::{
    Arrows3D, LineStrips3D, Mesh3D, Points3D, Scalars, SeriesLines, TextDocument, TextLog,
    Transform3D, ViewCoordinates,
};
use re_sdk_types::components::{MediaType, Radius};
use re_sdk_types::datatypes::{Float32, Quaternion, UInt32};
use re_sdk_types::{AnyValues, Rotation3D};

use crate::blueprint;
use crate::rrd::Rrd;
use crate::view_model::{self, LinkShape, Scale, single};

/// The name under which viewers keep what a user changed of the layout.
pub(crate) const APPLICATION: &str = "palpate";
/// How long a viewer may take to answer at first, and to take what is left at the end.
const PATIENCE: [Duration; 2] = [Duration::from_secs(10), Duration::from_secs(60)];

// Distinct on a dark background and on a light one.
const MEASURED: [u8; 3] = [150, 150, 150];
const PREDICTED: [u8; 3] = [40, 140, 245];
const ERROR: [u8; 3] = [235, 80, 60];
const LINK: [u8; 3] = [190, 196, 205];
const CONTACT: [u8; 3] = [255, 90, 60];
const WOOD: [u8; 3] = [150, 105, 70];
const LEAF: [u8; 3] = [70, 150, 70];

/// What stays as it is throughout a recording.
#[derive(Debug, Clone)]
pub struct Scene {
    /// What the recording is called in a viewer.
    pub name: String,
    /// What the recording is, in Markdown.
    pub about: String,
    /// The links that have a shape.
    pub links: Vec<LinkShape>,
    /// `world_from_link` of each at first: what the camera is turned to.
    pub world_from_link: Vec<Isometry3<f64>>,
    /// Joints by name, base to tip.
    pub joints: Vec<String>,
    /// The lattice of contacts and fields.
    pub lattice: Lattice,
    /// Whether frames have a time.
    pub clock: bool,
    /// Whether there will be torques; without, the field has all the room.
    pub torques: bool,
}

/// One sample.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Its number in the recording.
    pub sample: u64,
    /// Its time in the recording, s.
    pub time_s: Option<f64>,
    /// `world_from_link` of each of [`Scene::links`].
    pub world_from_link: &'a [Isometry3<f64>],
    /// What the arm displaces.
    pub contacts: &'a Contacts,
    /// `None` while the tare is being taken.
    pub torque: Option<Torque<'a>>,
}

/// The torque of one sample, n_joints, N·m.
#[derive(Debug, Clone, Copy)]
pub struct Torque<'a> {
    /// τ_ext.
    pub measured: &'a DVector<f64>,
    /// τ̂.
    pub predicted: &'a DVector<f64>,
}

/// Why something cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ViewError {
    /// No address that Rerun understands.
    #[error(
        "`{url}` is no address of a Rerun viewer: {reason}; wanted one like \
         rerun+http://127.0.0.1:9876/proxy"
    )]
    Address { url: String, reason: String },
    /// Nobody listens.
    #[error("no Rerun viewer answers at `{url}`: {reason}")]
    NoAnswer { url: String, reason: String },
    /// The viewer went away.
    #[error("the Rerun viewer at `{url}` did not take everything: {reason}")]
    Lost { url: String, reason: String },
    /// The file cannot be written.
    #[error("the recording cannot be written: {0}")]
    Write(std::io::Error),
    /// Rerun refuses what it was given.
    #[error("Rerun cannot record this: {0}")]
    Record(Box<dyn std::error::Error + Send + Sync>),
}

impl From<RecordingStreamError> for ViewError {
    fn from(error: RecordingStreamError) -> Self {
        Self::Record(Box::new(error))
    }
}

/// Where the recording goes.
enum Place<'out> {
    Viewer(String),
    File(Rrd<'out>),
}

/// A recording under way.
pub struct Recording<'out> {
    stream: RecordingStream,
    place: Place<'out>,
    links: Vec<String>,
    joints: Vec<String>,
    lattice: Lattice,
    scale: Scale,
    touching: bool,
}

impl<'out> Recording<'out> {
    /// A recording that a viewer shows while it grows.
    ///
    /// # Errors
    ///
    /// If `url` is no address, or no viewer answers there within ten seconds.
    pub fn to_viewer(url: &str, scene: &Scene) -> Result<Self, ViewError> {
        let connected = builder(scene).connect_grpc_opts(url);
        let url = url.to_owned();
        let stream = connected
            .map_err(|error| ViewError::Address { url: url.clone(), reason: error.to_string() })?;
        let recording = Self::begin(stream, Place::Viewer(url.clone()), scene)?;
        // One that was just started does not listen yet, and Rerun asks on while it is flushed.
        let began = Instant::now();
        while let Err(error) = recording.stream.flush_with_timeout(PATIENCE[0]) {
            if began.elapsed() >= PATIENCE[0] {
                return Err(ViewError::NoAnswer { url, reason: error.to_string() });
            }
        }
        Ok(recording)
    }

    /// A recording as the bytes of an `.rrd` file; [`Recording::finish`] writes the last of them.
    ///
    /// # Errors
    ///
    /// If `out` refuses its first bytes.
    pub fn to_file(out: &'out mut dyn Write, scene: &Scene) -> Result<Self, ViewError> {
        let (stream, messages) = builder(scene).memory()?;
        Self::begin(stream, Place::File(Rrd::begin(messages, out)?), scene)
    }

    fn begin(
        stream: RecordingStream,
        place: Place<'out>,
        scene: &Scene,
    ) -> Result<Self, ViewError> {
        stream.set_log_tick_enabled(false);
        stream.set_log_time_enabled(false);
        blueprint::send(scene, &stream)?;
        let link = |link: &LinkShape| format!("world/arm/{}", part(&link.name));
        let recording = Self {
            place,
            links: scene.links.iter().map(link).collect(),
            joints: scene.joints.iter().map(|joint| part(joint)).collect(),
            lattice: scene.lattice.clone(),
            scale: Scale::default(),
            touching: false,
            stream,
        };
        recording.log_scene(scene)?;
        Ok(recording)
    }

    /// What is recorded once.
    fn log_scene(&self, scene: &Scene) -> Result<(), ViewError> {
        let log = |entity: &str, what: &dyn AsComponents| self.stream.log_static(entity, what);
        log("world", &ViewCoordinates::RIGHT_HAND_Z_UP())?;
        let about = TextDocument::new(scene.about.as_str());
        log("about", &about.with_media_type(MediaType::markdown()))?;
        for (entity, link) in self.links.iter().zip(&scene.links) {
            let normals = link.normals();
            let mesh = Mesh3D::new(link.vertices_m.iter().map(single))
                .with_triangle_indices(link.triangles.iter().copied())
                .with_vertex_normals(normals.iter().map(|n| single(&Point3::from(*n))))
                .with_albedo_factor(LINK);
            log(entity, &mesh)?;
        }
        let line = |entity: String, name: &str, colour: [u8; 3], width: f32| {
            let line = SeriesLines::new().with_names([name]).with_colors([colour]);
            log(&entity, &line.with_widths([width]))
        };
        for of in self.joints.iter().map(String::as_str).chain(["norm"]) {
            line(format!("torque/{of}/measured"), "measured", MEASURED, 1.5)?;
            line(format!("torque/{of}/predicted"), "predicted", PREDICTED, 2.0)?;
        }
        line("torque/norm/error".to_owned(), "error", ERROR, 1.0)?;
        line("contacts".to_owned(), "points touched", CONTACT, 1.0)?;
        Ok(())
    }

    /// Records that a touch starts with the next sample.
    ///
    /// # Errors
    ///
    /// If Rerun refuses it.
    pub fn touch(&mut self, name: &str, sample: u64, time_s: Option<f64>) -> Result<(), ViewError> {
        self.set_time(sample, time_s);
        Ok(self.stream.log("touches", &TextLog::new(format!("touch {name}")))?)
    }

    /// Adds a sample. Cost: 1.7 ms of processor time with Rerun built without optimisation.
    ///
    /// # Errors
    ///
    /// If Rerun refuses it, or a file its bytes.
    ///
    /// # Panics
    ///
    /// If there is not one pose a link of the scene: a bug in the caller.
    pub fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        assert_eq!(frame.world_from_link.len(), self.links.len(), "one pose per link");
        self.set_time(frame.sample, frame.time_s);
        for (entity, pose) in self.links.iter().zip(frame.world_from_link) {
            self.stream.log(entity.as_str(), &transform(pose))?;
        }
        self.log_contacts(frame.contacts)?;
        if let Some(torque) = &frame.torque {
            self.log_torque(torque)?;
        }
        match &mut self.place {
            Place::File(rrd) => rrd.row(),
            Place::Viewer(_) => Ok(()),
        }
    }

    fn log_contacts(&mut self, contacts: &Contacts) -> Result<(), ViewError> {
        self.scalar("contacts", contacts.len() as f64)?;
        if contacts.is_empty() && !self.touching {
            return Ok(()); // Nothing is there already.
        }
        self.touching = !contacts.is_empty();
        let drawn = view_model::thinned(contacts);
        let rests: Vec<[f32; 3]> =
            drawn.iter().map(|(cell, _)| single(&self.lattice.point(*cell))).collect();
        let vectors = drawn.iter().map(|(_, displacement)| *displacement);
        let moved = rests.iter().zip(vectors.clone());
        let moved = moved.map(|(rest, by)| [0, 1, 2].map(|axis| rest[axis] + by[axis]));
        let thickness = Radius::new_scene_units(0.07 * self.lattice.spacing_m() as f32);
        let ball = Radius::new_scene_units(0.2 * self.lattice.spacing_m() as f32);
        let arrows = Arrows3D::from_vectors(vectors).with_origins(rests.iter().copied());
        let arrows = arrows.with_radii([thickness]).with_colors([CONTACT]);
        let points = Points3D::new(moved).with_radii([ball]).with_colors([CONTACT]);
        self.stream.log("world/contacts/displaced", &arrows)?;
        Ok(self.stream.log("world/contacts/at", &points)?)
    }

    fn log_torque(&self, torque: &Torque<'_>) -> Result<(), ViewError> {
        let both = [("measured", torque.measured), ("predicted", torque.predicted)];
        for (what, tau) in both {
            self.scalar(&format!("torque/norm/{what}"), tau.norm())?;
            for (joint, tau) in self.joints.iter().zip(tau) {
                self.scalar(&format!("torque/{joint}/{what}"), *tau)?;
            }
        }
        self.scalar("torque/norm/error", (torque.predicted - torque.measured).norm())
    }

    fn scalar(&self, entity: &str, value: f64) -> Result<(), ViewError> {
        Ok(self.stream.log(entity, &Scalars::single(value))?)
    }

    /// Shows the field as it is at a sample; until the next one, it stays so.
    ///
    /// # Errors
    ///
    /// If Rerun refuses it.
    pub fn field(
        &mut self,
        field: &Field,
        sample: u64,
        time_s: Option<f64>,
    ) -> Result<(), ViewError> {
        self.set_time(sample, time_s);
        if self.scale.widen(field) {
            let document = TextDocument::new(blueprint::colours(&self.scale));
            self.stream.log("colours", &document.with_media_type(MediaType::markdown()))?;
        }
        let cells = self.scale.cells(field);
        let radii = cells.radii_m.iter().map(|&radius| Radius::new_scene_units(radius));
        let points = Points3D::new(cells.points_m).with_colors(cells.colours).with_radii(radii);
        let known = AnyValues::default()
            .with_component_override::<Float32>("K_N_per_m", "K", cells.stiffness_n_per_m)
            .with_component_override::<Float32>("K_std_N_per_m", "K_std", cells.std_n_per_m)
            .with_component_override::<UInt32>("frames_that_touched", "N_obs", cells.counts);
        let both: [&dyn AsComponents; 2] = [&points, &known];
        Ok(self.stream.log("world/field", &both)?)
    }

    /// Shows an elastic body as it is bent at a sample; until the next one, it stays so. `segments_m` are the
    /// start and end of each of its segments, m, world frame.
    ///
    /// # Errors
    ///
    /// If Rerun refuses it.
    pub fn body(
        &mut self,
        (body, segments_m): (&ElasticBody, &[[Point3<f64>; 2]]),
        sample: u64,
        time_s: Option<f64>,
    ) -> Result<(), ViewError> {
        self.set_time(sample, time_s);
        for (entity, kind, colour) in [
            ("world/body/wood", SegmentKind::Wood, WOOD),
            ("world/body/leaves", SegmentKind::Leaf, LEAF),
            ("world/body/blocks", SegmentKind::Block, WOOD),
        ] {
            let segments = body.segments().iter().zip(segments_m);
            let (radii, lines): (Vec<Radius>, Vec<[[f32; 3]; 2]>) = segments
                .filter(|(segment, _)| segment.kind == kind)
                .map(|(segment, ends)| {
                    let radius = Radius::new_scene_units(segment.radius_m as f32);
                    (radius, ends.each_ref().map(single))
                })
                .unzip();
            let lines = LineStrips3D::new(lines).with_radii(radii).with_colors([colour]);
            self.stream.log(entity, &lines)?;
        }
        Ok(())
    }

    fn set_time(&self, sample: u64, time_s: Option<f64>) {
        let sample = i64::try_from(sample).unwrap_or(i64::MAX);
        self.stream.set_time(blueprint::SAMPLE, TimeCell::from_sequence(sample));
        match time_s {
            Some(time_s) => self.stream.set_duration_secs(blueprint::TIME, time_s),
            None => self.stream.disable_timeline(blueprint::TIME),
        }
    }

    /// Ends the recording: all of it is then with the viewer, or in the file.
    ///
    /// # Errors
    ///
    /// If the viewer went away, or the file refuses its last bytes.
    pub fn finish(self) -> Result<(), ViewError> {
        match self.place {
            Place::File(rrd) => rrd.finish(),
            Place::Viewer(url) => (self.stream.flush_with_timeout(PATIENCE[1]))
                .map_err(|error| ViewError::Lost { url, reason: error.to_string() }),
        }
    }
}

/// `RERUN=off` in the environment is for programs that log beside their work: here it is the work.
fn builder(scene: &Scene) -> RecordingStreamBuilder {
    RecordingStreamBuilder::new(APPLICATION).enabled(true).recording_name(scene.name.as_str())
}

fn transform(pose: &Isometry3<f64>) -> Transform3D {
    let rotation = pose.rotation.coords.map(|number| number as f32);
    let rotation = Quaternion::from_xyzw([rotation.x, rotation.y, rotation.z, rotation.w]);
    let at = single(&Point3::from(pose.translation.vector));
    Transform3D::from_translation_rotation(at, Rotation3D::from(rotation))
}

/// A name as one part of an entity's path.
pub(crate) fn part(name: &str) -> String {
    re_sdk::EntityPathPart::new(name).escaped_string()
}
