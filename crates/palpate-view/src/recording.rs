//! Records arm, contacts, field and torques for a viewer, sample by sample.
//!
//! | entity                     | content                                                     |
//! |----------------------------|-------------------------------------------------------------|
//! | `world/arm/<link>`         | the link's shape once, its pose in every sample             |
//! | `world/contacts/at`        | displaced positions of the drawn contacts, m                |
//! | `world/contacts/displaced` | arrows from rest points to displaced positions, to scale    |
//! | `world/field`              | the drawn cells: K, its standard deviation, touching frames |
//! | `world/body/…`             | `wood`, `leaves`, `blocks` of an elastic body, as lines     |
//! | `torque/norm/…`            | norms of `measured`, `predicted` and `error`, N·m           |
//! | `torque/<joint>/…`         | `measured` and `predicted`, N·m                             |
//! | `contacts`                 | number of cells touched, drawn or not                       |
//! | `colours`                  | text that explains the colours of stiffness                 |
//! | `about`, `touches`         | text about the recording; start and name of each touch      |
//!
//! Timelines are `sample`, the number of the sample, and `time`, s, where there is a clock.
//! [`crate::view_model`] decides what is drawn, `blueprint.rs` how it is laid out.
//!
//! Rerun collects and sends data on its own threads. A viewer that cannot keep up blocks the caller
//! once 100 MB wait for it; so a caller that must not block records on a separate thread and drops
//! frames.

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

/// Name under which viewers save changes of the layout by the user.
pub(crate) const APPLICATION: &str = "palpate";
/// Largest time for a viewer to answer at first, and to take the remaining data at the end.
const PATIENCE: [Duration; 2] = [Duration::from_secs(10), Duration::from_secs(60)];

// Colours that are distinct on dark and on light backgrounds.
const MEASURED: [u8; 3] = [150, 150, 150];
const PREDICTED: [u8; 3] = [40, 140, 245];
const ERROR: [u8; 3] = [235, 80, 60];
const LINK: [u8; 3] = [190, 196, 205];
const CONTACT: [u8; 3] = [255, 90, 60];
const WOOD: [u8; 3] = [150, 105, 70];
const LEAF: [u8; 3] = [70, 150, 70];

/// Data that is constant throughout a recording.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Name of the recording in the viewer.
    pub name: String,
    /// Description of the recording, in Markdown.
    pub about: String,
    /// The links that have a shape.
    pub links: Vec<LinkShape>,
    /// First `world_from_link` of each of these links, at which the camera is directed.
    pub world_from_link: Vec<Isometry3<f64>>,
    /// Joint names, base to tip.
    pub joints: Vec<String>,
    /// The lattice of contacts and fields.
    pub lattice: Lattice,
    /// Whether frames have a time.
    pub clock: bool,
    /// Whether frames have torques; if not, the layout has no torque plots.
    pub torques: bool,
}

/// One sample.
#[derive(Debug, Clone, Copy)]
pub struct DrawnSample<'a> {
    /// Number of the sample in the recording.
    pub sample: u64,
    /// Time in the recording, s.
    pub time_s: Option<f64>,
    /// `world_from_link` of each of [`Scene::links`].
    pub world_from_link: &'a [Isometry3<f64>],
    /// The cells that the arm displaces.
    pub contacts: &'a Contacts,
    /// Torque; `None` while the tare is being taken.
    pub torque: Option<SampleTorque<'a>>,
}

/// The torque of one sample, n_joints, N·m.
#[derive(Debug, Clone, Copy)]
pub struct SampleTorque<'a> {
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
    /// The address is not one of Rerun's.
    #[error(
        "`{url}` is no address of a Rerun viewer: {reason}; wanted one like \
         rerun+http://127.0.0.1:9876/proxy"
    )]
    Address { url: String, reason: String },
    /// No viewer answers.
    #[error("no Rerun viewer answers at `{url}`: {reason}")]
    NoAnswer { url: String, reason: String },
    /// The viewer closed before it had received everything.
    #[error("the Rerun viewer at `{url}` did not receive everything: {reason}")]
    Lost { url: String, reason: String },
    /// The file cannot be written.
    #[error("the recording cannot be written: {0}")]
    Write(std::io::Error),
    /// Rerun refuses the data.
    #[error("Rerun cannot record this: {0}")]
    Record(Box<dyn std::error::Error + Send + Sync>),
}

impl From<RecordingStreamError> for ViewError {
    fn from(error: RecordingStreamError) -> Self {
        Self::Record(Box::new(error))
    }
}

/// Destination of the recording.
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
    /// Starts a recording that a viewer shows live.
    ///
    /// # Errors
    ///
    /// If `url` is not a valid address, or no viewer answers there within ten seconds.
    pub fn to_viewer(url: &str, scene: &Scene) -> Result<Self, ViewError> {
        let connected = builder(scene).connect_grpc_opts(url);
        let url = url.to_owned();
        let stream = connected
            .map_err(|error| ViewError::Address { url: url.clone(), reason: error.to_string() })?;
        let recording = Self::begin(stream, Place::Viewer(url.clone()), scene)?;
        // A viewer that was just started does not listen yet; Rerun retries while flushing.
        let began = Instant::now();
        while let Err(error) = recording.stream.flush_with_timeout(PATIENCE[0]) {
            if began.elapsed() >= PATIENCE[0] {
                return Err(ViewError::NoAnswer { url, reason: error.to_string() });
            }
        }
        Ok(recording)
    }

    /// Starts a recording in the format of `.rrd` files; [`Recording::finish`] writes the last bytes.
    ///
    /// # Errors
    ///
    /// If the first bytes cannot be written to `out`.
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

    /// Records the constant data.
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

    /// Records a sample. Cost: 1.7 ms of processor time with Rerun built without optimisation.
    ///
    /// # Errors
    ///
    /// If Rerun refuses it, or the file cannot be written.
    ///
    /// # Panics
    ///
    /// If there is not one pose for each link of the scene, which is a bug in the caller.
    pub fn frame(&mut self, frame: &DrawnSample<'_>) -> Result<(), ViewError> {
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
            return Ok(()); // The viewer already shows no contacts.
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

    fn log_torque(&self, torque: &SampleTorque<'_>) -> Result<(), ViewError> {
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

    /// Records the field at a sample; the viewer shows it until the next one.
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

    /// Records an elastic body as it is bent at a sample; the viewer shows it until the next one. `segments_m`: start
    /// and end of each of its segments, m, world frame.
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

    /// Ends the recording, after all data has reached the viewer or the file.
    ///
    /// # Errors
    ///
    /// If the viewer has closed, or the file cannot be written.
    pub fn finish(self) -> Result<(), ViewError> {
        match self.place {
            Place::File(rrd) => rrd.finish(),
            Place::Viewer(url) => (self.stream.flush_with_timeout(PATIENCE[1]))
                .map_err(|error| ViewError::Lost { url, reason: error.to_string() }),
        }
    }
}

/// Enabled even if the environment has `RERUN=off`: recording is the purpose of this program.
fn builder(scene: &Scene) -> RecordingStreamBuilder {
    RecordingStreamBuilder::new(APPLICATION).enabled(true).recording_name(scene.name.as_str())
}

fn transform(pose: &Isometry3<f64>) -> Transform3D {
    let rotation = pose.rotation.coords.map(|number| number as f32);
    let rotation = Quaternion::from_xyzw([rotation.x, rotation.y, rotation.z, rotation.w]);
    let at = single(&Point3::from(pose.translation.vector));
    Transform3D::from_translation_rotation(at, Rotation3D::from(rotation))
}

/// Escapes a name as one part of an entity path.
pub(crate) fn part(name: &str) -> String {
    re_sdk::EntityPathPart::new(name).escaped_string()
}
