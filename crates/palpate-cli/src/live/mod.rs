//! `palpate live`: maps beside a running robot.

mod checker;
mod reporter;
mod status;
#[cfg(feature = "viewer")]
mod viewer;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::unstable::PauseConfig;
use palpate::{
    Arm, Differentiation, EstimatorKind, ExternalTorqueConfig, Mapper, TorqueModel, TorqueStream,
};
use palpate_io::field::{self, SavedField};
use palpate_io::log::AngleUnit;
use palpate_learn::tune::FixedSettings;
use palpate_live::checkpoint::CheckpointConfig;
use palpate_live::guard::{Guard, GuardConfig};
use palpate_live::ros::{
    FlagTopics, NetworkConfig, NetworkProcess, ParamValue, Parameter, ServiceEncoding, TopicNames,
};
use palpate_live::session::Session;
use palpate_live::{LiveConfig, LiveElasticBody, QuerySocket, SessionEvent, run as run_live};
use palpate_work::Progress;
use palpate_work::settings::named;
use palpate_work::torque::{ThresholdSource, threshold, wrench_link};
use palpate_work::tune::{Tune, given};
use palpate_work::{arm_file, prior, resume, robot};
use tempfile::NamedTempFile;

use crate::args::{number_in, quick_or_off};
use crate::error::CliError;
use crate::file_paths::FilePaths;
use crate::object_args::ObjectArgs;
use crate::output::{Output, complain};
use crate::settings::{AllSettings, Settings};
#[cfg(not(feature = "viewer"))]
use crate::view;
use crate::{file_paths, interrupt, logs, program};
use checker::Checker;
use reporter::Reporter;
use status::Shown;
#[cfg(feature = "viewer")]
use viewer::Viewer;

const EXAMPLES: &str = "Examples:
  palpate live -o field.npz
  palpate live --robot panda.urdf --torque-sign minus --joint-states /franka/joint_states -o field.npz
  palpate live --robot /robot_description -o field.npz
  palpate live -o field.npz --resume --guard 25
  palpate live --localhost --json-lines --duration 60
  palpate live --robot fr3.urdf --arm arm.toml --no-map
  palpate live -o field.npz --viewer
  palpate live -o field.npz --ask palpate.sock --cloud object.ply

ROS need not be installed: palpate contains a DDS implementation. It subscribes to a topic of \
sensor_msgs/msg/JointState with efforts, or of control_msgs/msg/DynamicJointState, and publishes

  /palpate/torque_external   the external torque, which the object exerts on the joints (JointState)
  /palpate/torque_predicted  its prediction, made before the sample was learnt (JointState)
  /palpate/torque_std        with --arm or --no-map: standard deviation of the external torque
  /palpate/touched           with --arm or --no-map: whether something is touched (Bool)
  /palpate/contacts          points in contact, displacements, stiffness (PointCloud2)
  /palpate/field             the field near these points (PointCloud2)
  /palpate/wrench            force and torque of the object on each touched link, or with --wrench-link on that link (WrenchStamped)
  /palpate/stop              with --guard: whether the robot must stop (Bool, 50 times a second;
                             silence means stop)
  /palpate/guard             with --guard: the reason, with the time (DiagnosticArray)
  /diagnostics               rate, latency, dropped samples, contacts, errors (DiagnosticArray)

and answers /palpate/tare, /palpate/reset and /palpate/save (std_srvs/srv/Trigger), and \
/palpate/ask (palpate_ros/srv/AskTrajectory). A touch begins when the arm pauses without contact, \
or, after a call of /palpate/tare, at the next pause, with or without contact. Samples may come \
at any rate; replays fill the time between them, so that the field depends on the speed of the \
machine. Ctrl-C saves the field and ends the session.

--cloud makes an elastic body from a coloured cloud of the object (estimator `elastic`). The body \
learns each touch once it is over. It is saved in the field's file, used together with the field \
to answer questions, and shown in the viewer. /palpate/torque_predicted and the guard use the \
field alone.";

/// Flags of `palpate live`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Topic of the joint states [default: the only one that is published]
    #[arg(long, value_name = "TOPIC")]
    joint_states: Option<String>,
    /// Output file of the field, for checkpoints and at the end; without it, nothing is saved
    #[arg(long, short, value_name = "FIELD.npz")]
    output: Option<PathBuf>,
    /// Time between two checkpoints, s
    #[arg(long, value_name = "S", default_value = "10", value_parser = period())]
    checkpoint: f64,
    /// Continue from the field in --output, if the file exists
    #[arg(long, requires = "output")]
    resume: bool,
    /// Take the prior mean of each cell from a field
    #[arg(long, value_name = "FIELD.npz", conflicts_with_all = ["resume", "cloud", "body"])]
    prior: Option<PathBuf>,
    /// Whether settings that are not given are chosen by cross-validation during the session: `quick` or `off`
    /// [default: quick; off with --prior, --cloud, --body, --no-map or --estimator ekf, or if a field is continued]
    #[arg(
        long, value_name = "HOW", num_args = 0..=1, default_missing_value = "quick",
        require_equals = true, value_parser = quick_or_off
    )]
    tune: Option<Tune>,
    /// Publish that the robot must stop, unless it is known that no joint's measured or predicted
    /// external torque exceeds this limit, N·m
    #[arg(long, value_name = "LIMIT", value_parser = number_in(f64::MIN_POSITIVE..=f64::MAX, "a number above 0"))]
    guard: Option<f64>,
    /// Longest time without a usable joint state before the guard says stop, s
    #[arg(long, value_name = "S", requires = "guard", default_value = "0.1", value_parser = period())]
    guard_silence: f64,
    /// Longest time that joint states may wait for the mapper before the guard says stop, s
    #[arg(long, value_name = "S", requires = "guard", default_value = "0.25", value_parser = period())]
    guard_lag: f64,
    /// Largest difference between the torques at rest and gravity, N·m: above it the arm counts as loaded
    /// [default: that of --guard]
    #[arg(long, value_name = "LIMIT", requires = "guard", value_parser = number_in(f64::MIN_POSITIVE..=f64::MAX, "a number above 0"))]
    guard_bias: Option<f64>,
    /// Compare the limit with the outer end of the band around the predicted torque, at a level such as
    /// 0.9; the field to resume must have bands
    #[arg(long, value_name = "LEVEL", requires_all = ["guard", "resume"], value_parser = number_in(0.01..=0.999, "a level from 0.01 to 0.999"))]
    guard_band: Option<f64>,
    /// Stop what MoveIt executes when the guard says stop
    #[arg(long, requires = "guard")]
    guard_moveit: bool,
    /// Socket for questions about the torque of a motion: one line of JSON in each direction, such as
    /// {"path": [[0.1, 0.2], [0.1, 0.3]]}
    #[arg(long, value_name = "SOCKET")]
    ask: Option<PathBuf>,
    /// Time for which the arm must stand still without contact before a touch begins, s
    #[arg(long, value_name = "S", default_value = "0.5", value_parser = period())]
    idle: f64,
    /// Largest number of waiting samples; beyond it, the oldest are dropped
    #[arg(long, value_name = "N", default_value = "512", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    queue: u32,
    /// DDS domain
    #[arg(long, value_name = "N", env = "ROS_DOMAIN_ID", default_value = "0")]
    domain: u16,
    /// Communicate with this machine only
    #[arg(long)]
    localhost: bool,
    /// How requests of services are identified on the wire: `cyclone` for robots on rmw_cyclonedds
    #[arg(long, value_name = "KIND", default_value = "enhanced", value_parser = named::<ServiceEncoding>(&["enhanced", "cyclone"]))]
    services: ServiceEncoding,
    /// Take the time from the topic /clock, as a simulation or a replay gives it (use_sim_time of ROS)
    #[arg(long)]
    sim_time: bool,
    /// Another name for a topic, a service, the node (__node) or its namespace (__ns), as in ROS; may be given several
    /// times
    #[arg(long, value_name = "FROM:=TO")]
    remap: Vec<String>,
    /// End after this time, s
    #[arg(long, value_name = "S", value_parser = period())]
    duration: Option<f64>,
    /// Show the session in a Rerun viewer: start one, or use the one that runs at URL
    #[arg(long, value_name = "URL", num_args = 0..=1, require_equals = true)]
    #[allow(clippy::option_option)] // not asked for, or asked for with or without an address
    viewer: Option<Option<String>>,
    /// Map nothing: publish external torques, their standard deviations and whether something is touched
    #[arg(long, conflicts_with_all = ["output", "resume", "prior", "ask", "viewer", "guard", "cloud", "body"])]
    no_map: bool,
    /// With --no-map: also publish the force and moment at the origin of this link that explain the torques best
    #[arg(long, value_name = "LINK", requires = "no_map")]
    wrench_link: Option<String>,
    /// Print figures (once per second) and notes as lines of JSON, in place of the view
    #[arg(long)]
    json_lines: bool,
    #[command(flatten)]
    object: ObjectArgs,
    #[command(flatten)]
    settings: AllSettings,
}

/// The model of an identified arm, and the convention of its torques.
struct Identified {
    model: TorqueModel,
    torques: ExternalTorqueConfig,
}

/// Accepted number of false alarms per hour of contact-free motion.
const FALSE_ALARMS_PER_HOUR: f64 = 1.0;

/// A parser of periods, s.
fn period() -> impl Fn(&str) -> Result<f64, String> + Clone {
    number_in(0.001..=1e7, "a number of seconds from 0.001 to 10000000")
}

impl Args {
    /// Refuses invalid rules of --remap, and an output that cannot be written, or would replace an input or a field
    /// that was learnt before.
    fn check_places(&self, settings: &Settings) -> Result<(), CliError> {
        self.names()?;
        let mut places = FilePaths::read(&self.settings, settings, &[]);
        places.input("the prior (--prior)", self.prior.as_deref());
        self.object.add_to(&mut places);
        places.output("the field (--output)", self.output.as_deref())?;
        match &self.output {
            Some(path) if path.exists() && !self.resume => Err(CliError::Usage(format!(
                "`{}` is there already, and the first checkpoint would replace it; go on from it \
                 with --resume, or choose another name",
                path.display()
            ))),
            _ => Ok(()),
        }
    }

    fn guard(&self, arm: &Arm) -> Option<Guard> {
        let mut config = GuardConfig::new(self.guard?);
        config.silence = Duration::from_secs_f64(self.guard_silence);
        config.lag = Duration::from_secs_f64(self.guard_lag);
        config.bias_limit_n_m = self.guard_bias.unwrap_or(config.bias_limit_n_m);
        Some(Guard::new(config, arm))
    }

    fn network(&self, arm: &Arm, settings: &Settings) -> Result<NetworkProcess, CliError> {
        let network = self.network_of(arm.robot.joint_names().map(str::to_owned).collect())?;
        Ok(network.with_parameters(self.parameters(settings)))
    }

    fn network_of(&self, joints: Vec<String>) -> Result<NetworkProcess, CliError> {
        let Self { domain, localhost, services, sim_time, .. } = *self;
        let flag = self.guard.map(|_| FlagTopics { moveit: self.guard_moveit });
        let names = self.names()?;
        let config = NetworkConfig { domain, localhost, services, names, sim_time };
        Ok(NetworkProcess::new(network_command, config, joints, flag))
    }

    /// The topic of the joint states, if it is given.
    fn joint_states(&self) -> Result<Option<String>, CliError> {
        let names = self.names()?;
        Ok(match &self.joint_states {
            Some(topic) => Some(names.of(topic)),
            None => names.renamed("/joint_states"),
        })
    }

    fn names(&self) -> Result<TopicNames, CliError> {
        TopicNames::new(&self.remap).map_err(|error| CliError::Usage(format!("--remap: {error}")))
    }

    /// The parameters of the session, as `ros2 param` shows them.
    fn parameters(&self, settings: &Settings) -> Vec<Parameter> {
        let text = |text: Option<String>| ParamValue::Text(text.unwrap_or_default());
        let field = self.output.as_ref().map(|path| path.display().to_string());
        [
            (
                "use_sim_time",
                ParamValue::Bool(self.sim_time),
                "whether time is that of /clock (--sim-time)",
            ),
            ("robot", ParamValue::Text(settings.robot.name().to_owned()), "the robot (--robot)"),
            (
                "joint_states",
                text(self.joint_states().ok().flatten()),
                "topic of the joint states; empty: the only such topic",
            ),
            ("output", text(field), "file of the field; empty: it is not saved"),
            ("map", ParamValue::Bool(!self.no_map), "whether a field is learned (--no-map)"),
            (
                "guard",
                ParamValue::Number(self.guard.unwrap_or(0.0)),
                "limit of the guard, N·m; 0: no guard",
            ),
            ("checkpoint", ParamValue::Number(self.checkpoint), "time between two checkpoints, s"),
            (
                "idle",
                ParamValue::Number(self.idle),
                "time for which the arm must stand still before a touch begins, s",
            ),
        ]
        .into_iter()
        .map(|(name, value, about)| Parameter {
            name: name.to_owned(),
            value,
            about: about.to_owned(),
        })
        .collect()
    }

    /// A file with the URDF from a topic: `--robot /robot_description` names a topic, unless such a file exists.
    fn description(
        &self,
        settings: &mut Settings,
        output: &Output,
    ) -> Result<Option<NamedTempFile>, CliError> {
        let topic = settings.robot.name().to_owned();
        if !topic.starts_with('/') || Path::new(&topic).exists() || topic.ends_with(".urdf") {
            return Ok(None);
        }
        output.note(&format!("waiting for the robot's description on {topic}"));
        let topic = self.names()?.of(&topic);
        let network = self.network_of(Vec::new())?;
        let urdf = network.description(&topic, interrupt::pressed);
        if interrupt::pressed() {
            return Err(CliError::Interrupted { kept: String::new() });
        }
        let urdf = urdf.map_err(CliError::file)?;
        let write = || {
            let mut file = tempfile::Builder::new().suffix(".urdf").tempfile()?;
            file.write_all(urdf.as_bytes())?;
            Ok(file)
        };
        let file = write().map_err(|source| CliError::Write { what: topic, source })?;
        settings.robot.robot = Some(file.path().display().to_string());
        Ok(Some(file))
    }

    fn session(
        &self,
        mapper: Mapper,
        arm: &Arc<Arm>,
        identified: Option<Identified>,
    ) -> Result<Session, CliError> {
        let mut idle = PauseConfig::default();
        idle.idle_s = self.idle;
        let mapper = match self.guard_band {
            None => mapper,
            Some(level) => {
                let bands = mapper.calibration().map_or("no bands".to_owned(), |own| {
                    let lowest = own.quantiles.first().map_or(0.0, |first| first.level);
                    format!("bands from {lowest} to {}", own.highest_level())
                });
                mapper.with_band(level).ok_or_else(|| {
                    CliError::Usage(format!("--guard-band is {level}, but the field has {bands}"))
                })?
            }
        };
        let session = Session::new(mapper, idle, self.guard(arm))
            .map_err(|error| CliError::Usage(format!("--idle: {error}")))?;
        let Some(Identified { model, torques }) = identified else { return Ok(session) };
        let causal = model.clone().for_differentiation(Differentiation::Causal);
        let (threshold, from) = threshold(&causal, None, FALSE_ALARMS_PER_HOUR)?;
        let stream = TorqueStream::new(Arc::clone(arm), model, torques).map_err(CliError::Usage)?;
        if from == ThresholdSource::Guess {
            complain(
                "warning: the contact threshold is a guess; identify the arm with `palpate identify`",
            );
        }
        let session = session.identified(stream, threshold, self.no_map);
        match &self.wrench_link {
            Some(name) => Ok(session.with_wrench_at(wrench_link(&arm.robot, name)?)),
            None => Ok(session),
        }
    }

    /// The model of the identified arm, and the convention of its torques; `None` without --arm and --no-map.
    fn identified(
        &self,
        arm: &Arm,
        settings: &Settings,
        output: &Output,
    ) -> Result<Option<Identified>, CliError> {
        if settings.robot.arm.is_none() && !self.no_map {
            return Ok(None);
        }
        let model = arm_file::or_urdf(&settings.robot, &arm.robot, output)?;
        if self.guard.is_some() {
            return Err(CliError::Usage(
                "the guard uses measured torques without the model of an identified arm: leave out --guard, or --arm \
                 and --no-map"
                    .to_owned(),
            ));
        }
        let mut settings = settings.clone();
        arm_file::complete_convention(&mut settings, &arm.robot)?;
        let torques = settings.torque_convention_for_robot()?;
        Ok(Some(Identified { model, torques }))
    }

    fn checkpoint(&self) -> Option<CheckpointConfig> {
        let every = Duration::from_secs_f64(self.checkpoint);
        self.output.clone().map(|path| CheckpointConfig { path, every })
    }

    /// Checks the settings. Returns which of them the user has given, if the others are chosen during the session.
    fn choose(&self, settings: &Settings) -> Result<Option<FixedSettings>, CliError> {
        if !self.resume {
            settings.config()?;
        }
        let begins_with =
            self.field().is_some() || self.prior.is_some() || self.object.is_given() || self.no_map;
        let can_choose = !begins_with && settings.config()?.method == EstimatorKind::Map;
        let chooses = match self.tune {
            Some(Tune::Quick) if !can_choose => {
                return Err(CliError::Usage(
                    "settings are not chosen with --prior, --cloud, --body, --no-map or --estimator ekf, or for a \
                     field that is continued; leave out --tune"
                        .to_owned(),
                ));
            }
            Some(tune) => tune == Tune::Quick,
            None => can_choose,
        };
        Ok(chooses.then(|| given(settings)))
    }

    /// The file of the field to continue from, if --resume is given and the file exists.
    fn field(&self) -> Option<&Path> {
        self.output.as_deref().filter(|path| self.resume && path.exists())
    }

    /// Names settings of logs that were given and change nothing here.
    fn warn_of_unused_log_settings(settings: &Settings, output: &Output) {
        let log = &settings.log;
        let given = [
            ("angle_unit", log.angle_unit_given().is_some_and(|unit| unit != AngleUnit::Rad)),
            ("time_unit", log.time_unit.is_some_and(|unit| unit.given().is_some())),
            ("columns", log.columns.is_some()),
            ("topic", log.topic.is_some()),
            ("touch_topic", log.touch_topic.is_some()),
            ("joints", log.joints.is_some()),
            ("split_gap_s", log.split_gap_s.is_some()),
            ("split_idle", log.split_idle.is_some()),
            ("idle_s (here it is --idle)", log.idle_s.is_some()),
        ];
        let given: Vec<&str> = given.into_iter().filter(|own| own.1).map(|own| own.0).collect();
        if !given.is_empty() {
            output.warn(&format!(
                "settings without effect on `live`, where joint states are messages in rad and m with time stamps: {}",
                given.join(", ")
            ));
        }
    }

    /// Notes which robot is used, which settings have no effect, and whether nothing is saved.
    fn print_notes(&self, arm: &Arm, settings: &Settings, output: &Output) {
        Self::warn_of_unused_log_settings(settings, output);
        logs::note_robot(arm, settings, output);
        if self.output.is_none() && !self.no_map {
            output.note("the field is not saved: give --output FIELD.npz to save it");
        }
    }

    /// A new mapper and body, or those of the output file.
    fn begin(
        &self,
        arm: &Arc<Arm>,
        settings: &Settings,
        output: &Output,
    ) -> Result<(Mapper, Option<Arc<LiveElasticBody>>), CliError> {
        let Some(path) = self.field() else {
            let config = settings.config()?;
            let mapper = prior::mapper(self.prior.as_deref(), arm, config, output)?;
            let (bodies, _) = self.object.bodies(output)?;
            let body = (!bodies.is_empty()).then(|| {
                LiveElasticBody::new(arm, mapper.config(), &bodies).map_err(CliError::file)
            });
            return Ok((mapper, body.transpose()?.map(Arc::new)));
        };
        let mut saved = field::load(path).map_err(CliError::file)?;
        let (model, name) = (saved.field.elastic.take(), path.display().to_string());
        let touches = std::mem::take(&mut saved.elastic_touches);
        output.note(&format!("continuing from `{name}`: processing the touches in its memory"));
        let snapshot = resume::snapshot_of(saved, &name, arm, settings)?;
        let mapper = resume::mapper(&name, arm, snapshot, output)?;
        if self.object.is_given() {
            output.note(
                "--cloud and --body are not used: the field to continue from has its own elastic body, or none",
            );
        }
        let body =
            model.map(|model| LiveElasticBody::resumed(arm, mapper.config(), model, touches));
        Ok((mapper, body.map(Arc::new)))
    }
}

/// The command that starts this program as the network process.
fn network_command() -> Command {
    let mut command = program::again();
    command.arg("live-network");
    command
}

fn open_socket(path: &Path) -> Result<QuerySocket, CliError> {
    QuerySocket::bind(path).map_err(|error| {
        CliError::from(format!(
            "the socket `{}` (--ask) cannot be opened: {error}; choose another name",
            path.display()
        ))
    })
}

/// Maps until Ctrl-C, or until the time is over.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    args.object.select(&mut settings, args.field().is_some())?;
    let choose = args.choose(&settings)?;
    interrupt::listen(); // from here on, temporary files are made and deleted
    args.check_places(&settings)?;
    let description = args.description(&mut settings, output)?;
    let hold = args.output.as_deref().map(file_paths::hold_field).transpose()?;
    let arm = robot::load(&settings.robot, output)?;
    drop(description);
    let identified = args.identified(&arm, &settings, output)?;
    let (mapper, body) = args.begin(&arm, &settings, output)?;
    args.print_notes(&arm, &settings, output);

    #[cfg(feature = "viewer")]
    let viewer = {
        let start =
            |url: &Option<String>| Viewer::start(url.as_deref(), &arm, &mapper.config().lattice);
        args.viewer.as_ref().map(start).transpose()?
    };
    #[cfg(feature = "viewer")]
    let feed = viewer.as_ref().map(Viewer::inbox);
    #[cfg(not(feature = "viewer"))]
    let feed = args.viewer.as_ref().map(|_| Err(view::without_viewer())).transpose()?;
    let (checker, strict) = (Checker::start(&mapper), settings.log.strict.unwrap_or_default());
    let session = args.session(mapper, &arm, identified)?;
    let network = args.network(&arm, &settings)?;
    let ask = args.ask.as_deref().map(open_socket).transpose()?;
    let ends = args.duration.map(|s| Instant::now() + Duration::from_secs_f64(s));
    let reporter = Reporter::new(Shown::new(*output, args.json_lines), checker, strict);
    let over = || interrupt::pressed() || ends.is_some_and(|ends| Instant::now() >= ends);
    let stop = || reporter.looks_wrong() || over();
    let config = LiveConfig {
        joint_states: args.joint_states()?,
        queue: args.queue as usize,
        checkpoint: args.checkpoint(),
        view: feed,
        mapped: Some(reporter.inbox()),
        body: body.clone(),
        choose,
    };
    let show = |event| reporter.show(event);
    let (session, defect) =
        run_live(&network, session, &config, ask.as_ref(), stop, show).map_err(CliError::file)?;
    let (mut shown, wrong) = reporter.end();
    shown.clear();
    #[cfg(feature = "viewer")]
    if let Some(viewer) = viewer {
        viewer.end(output);
    }
    if let Some(path) = &args.output {
        save(path, &session, body.as_deref(), &mut shown)?;
    }
    drop(hold);
    shown.end(&session, args.output.as_deref(), args.no_map)?;
    match (defect, wrong) {
        (Some(defect), _) => Err(CliError::file(defect)),
        (None, Some(wrong)) => Err(CliError::from(format!("{wrong} (--strict)"))),
        (None, None) => Ok(()),
    }
}

/// Saves the field at the end, with the elastic body if there is one.
fn save(
    path: &Path,
    session: &Session,
    body: Option<&LiveElasticBody>,
    shown: &mut Shown,
) -> Result<(), CliError> {
    let mut saved = SavedField::of_mapper(session.mapper());
    body.inspect(|body| body.put_into(&mut saved));
    file_paths::save(path, &saved)?;
    if let Some(waiting) = body.map(LiveElasticBody::waiting).filter(|waiting| *waiting > 0) {
        let path = path.display();
        shown.show(SessionEvent::Note(format!(
            "the elastic body has not learnt the last touches ({waiting}) yet, but the field contains \
             them; learn them with `palpate map --from {path} -o {path}`"
        )));
    }
    Ok(())
}
