//! `palpate identify`: payload, friction, bias and delay of an arm, from logs of its free motion.

use std::path::PathBuf;

use palpate::Robot;
use palpate_io::robot_files::with_inertia;
use palpate_learn::identify::{Estimate, IdentifiedArm, MIN_MOTION};
use palpate_work::arm_file;
use palpate_work::identify::{self, IdentifySettings};
use serde_json::json;

use crate::error::CliError;
use crate::file_paths::FilePaths;
use crate::output::{Output, figure, table};
use crate::settings::RobotLogAndTouchSettings;
use crate::{file_paths, interrupt, logs};

const NOTES: &str = "Examples:
  palpate identify free_motion/ --robot robot.urdf -o arm.toml
  palpate identify monday.mcap tuesday.mcap --robot ur10e.urdf --tool-link tool0 --currents -o arm.toml
  palpate map recordings/ --robot robot.urdf --arm arm.toml -o field.npz

In the logs the arm must move freely, every joint in both directions, and partly slowly; `palpate \
excite` writes such a motion. Parameters that the logs determine poorly stay close to those of \
the URDF. Errors are measured on motion that was held out: whole touches, or quarters of them if \
there are fewer than three. Samples in which something is touched are left out, and a note says \
so.

--json contains the payload with standard deviations, and, if --tool-link is the flange, in the \
form of libfranka's setLoad and URScript's set_target_payload. The flags of the tare have no \
effect here: the bias is identified.";

/// Flags of `palpate identify`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Logs of free motion
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Output file of the identified arm, for --arm of other commands
    #[arg(long, short, value_name = "ARM.toml")]
    output: Option<PathBuf>,
    /// Output file of the URDF with the identified masses
    #[arg(long, value_name = "FILE.urdf")]
    urdf: Option<PathBuf>,
    /// Link in whose frame the payload is given [default: the link behind the last joint]
    #[arg(long, value_name = "LINK")]
    tool_link: Option<String>,
    /// The logged torques are motor currents: identify their gains as well [default: if columns are named currents]
    #[arg(long)]
    currents: bool,
    /// Print all results as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotLogAndTouchSettings,
}

/// Identifies the arm and prints the result.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    if settings.robot.arm.take().is_some() {
        return Err(CliError::Usage(
            "`identify` writes the file for --arm; leave --arm out".to_owned(),
        ));
    }
    let mut robot = settings.robot.clone();
    // The identified arm already contains the payload.
    (robot.payload_link, robot.payload_mass_kg, robot.payload_com_m) = (None, None, None);
    robot.arm.clone_from(&args.output);
    let mut places = FilePaths::read(&args.settings, &settings, &args.logs);
    places.output("the arm (--output)", args.output.as_deref())?;
    args.output.iter().try_for_each(|path| file_paths::check_older(path, "toml", |_| false))?;
    places.output("the URDF (--urdf)", args.urdf.as_deref())?;
    interrupt::listen();
    let flags = logs::torque_flags(&settings.touch);
    let (mut touches, arm) = logs::open_undecided(&args.logs, &mut settings, output)?;
    if args.currents {
        touches.treat_as_currents();
    }
    touches.decide_convention(&arm, None, &mut settings, output)?;
    let currents = touches.are_currents();
    let recorded = touches.read_for(&arm, &settings, output)?;
    let strict = settings.log.strict.unwrap_or_default();
    let wanted = IdentifySettings { tool_link: args.tool_link.clone(), currents, strict };
    let torques = settings.config()?.touch;
    let found = identify::run(&arm, &recorded, &torques, &wanted, output)?;

    let text = text(&found);
    if let Some(path) = &args.output {
        file_paths::write(path, &arm_file::text(&arm.robot, &found.model, &torques, &text))?;
    }
    if let Some(path) = &args.urdf {
        file_paths::write(path, &urdf_of(&settings, &arm.robot, &found)?)?;
    }
    for note in &found.notes {
        output.note(note);
    }
    if args.json {
        return output.json(&json(&found, args.tool_link.is_some()));
    }
    output.result(&text)?;
    let written = [("The arm", &args.output), ("The URDF", &args.urdf)];
    for (what, path) in written {
        if let Some(path) = path {
            output.result(&format!("{what} is in `{}`.\n", path.display()))?;
        }
    }
    // An arm that does not fit is no basis for a next step.
    if args.output.is_some() && found.misfit.is_none() {
        let robot = logs::robot_flags(&robot);
        output.result(&format!("Next: palpate torque LOG{robot}{flags}\n"))?;
    }
    Ok(())
}

/// The results as JSON, with payloads for controllers if the flange is known.
fn json(found: &IdentifiedArm, is_flange_known: bool) -> serde_json::Value {
    // Both payloads are in the frame of the flange, and only the user knows which link that is.
    let (libfranka, urscript) = if is_flange_known && found.payload.is_significant {
        (Some(set_load(found)), Some(set_payload(found)))
    } else {
        (None, None)
    };
    let mut json = palpate_work::identify::json(found);
    json["model"] = json!(found.model);
    json["libfranka"] = json!(libfranka);
    json["urscript"] = json!(urscript);
    json
}

/// The given URDF with the identified masses.
fn urdf_of(
    settings: &crate::settings::Settings,
    robot: &Robot,
    found: &IdentifiedArm,
) -> Result<String, CliError> {
    let name = settings.robot.name();
    let text = match Robot::built_in_urdf(name) {
        Some(text) => text.to_owned(),
        None => std::fs::read_to_string(name)
            .map_err(|error| CliError::from(format!("`{name}` cannot be read: {error}")))?,
    };
    let parameters = found.model.inertial.clone().into();
    with_inertia(&text, &robot.clone().with_inertial_parameters(&parameters))
        .map_err(|what| CliError::from(format!("`{name}` {what}")))
}

/// A value with its standard deviation as text; a dash if the logs do not determine it.
fn pm(value: Estimate, digits: usize, is_found: bool) -> String {
    if !is_found {
        return "-".to_owned();
    }
    format!("{:.digits$} ± {:.digits$}", value.value, value.std)
}

fn text(found: &IdentifiedArm) -> String {
    let payload = &found.payload;
    let mut text = if payload.is_significant {
        let com = payload.com_m.map(|axis| pm(axis, 3, true)).join(", ");
        let mass = pm(payload.mass_kg, 2, true);
        format!("Payload in the frame of `{}`: {mass} kg, centre {com} m.\n", payload.link)
    } else {
        let mass = pm(payload.mass_kg, 2, true);
        format!("Payload: none that can be distinguished from zero ({mass} kg).\n")
    };
    text += &format!(
        "Delay of the torques behind the positions: {} ms. Base parameters (combinations of masses): {} of {} are \
         known better than from the URDF.\n\n",
        pm(
            Estimate { value: 1e3 * found.delay_s.value, std: 1e3 * found.delay_s.std },
            1,
            found.timed
        ),
        found.base_parameters_identified,
        found.base_parameters
    );
    text += &joints(found);
    text + &residuals(found)
}

/// A table with a row for each joint.
fn joints(found: &IdentifiedArm) -> String {
    let head = [
        "joint",
        "Coulomb N·m",
        "viscous N·m·s/rad",
        "breakaway N·m",
        "asymmetry N·m",
        "hysteresis N·m",
        "bias N·m",
        "gain",
        "moved rad",
    ];
    let rows = found.joints.iter().map(|joint| {
        let moves = joint.moved >= MIN_MOTION;
        let slides = found.timed && moves;
        // What would be negative, and is held at zero, has no standard deviation.
        let not_negative = |value: Estimate, name: &str, is_found: bool| {
            let text = pm(value, 2, is_found);
            if is_found && joint.at_zero.contains(&name) { "0.00 ± -".to_owned() } else { text }
        };
        let hysteresis = slides.then_some(joint.hysteresis_n_m);
        vec![
            joint.name.clone(),
            not_negative(joint.coulomb_n_m, "coulomb_n_m", moves),
            not_negative(joint.viscous_n_m_s, "viscous_n_m_s", slides),
            pm(joint.breakaway_n_m, 2, slides && joint.is_breakaway_separable),
            pm(joint.asymmetry_n_m, 2, slides),
            figure(hysteresis, 2),
            pm(joint.bias_n_m, 2, true),
            pm(joint.gain, 3, true),
            format!("{:.2}", joint.moved),
        ]
    });
    table(&head, rows)
}

/// The residuals on held-out motion.
fn residuals(found: &IdentifiedArm) -> String {
    let total = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>().sqrt();
    let held_out = &found.held_out;
    let text = format!(
        "\nResidual of the measured torque after subtracting each model, on held-out motion, root mean square over all \
         joints,\nN·m; slow: means over {:.2} s, the time window from which speeds are computed:\n\n",
        2.0 * found.model.window_s
    );
    let row = |what: &str, all: &[f64], slow: &[f64]| {
        let each = all.iter().map(|own| format!("{own:.2}"));
        let mut row =
            vec![what.to_owned(), format!("{:.2}", total(all)), format!("{:.2}", total(slow))];
        row.extend(each);
        row
    };
    let mut head = vec!["after", "all", "slow"];
    head.extend(found.joints.iter().map(|joint| joint.name.as_str()));
    let [gravity, urdf, identified] = &held_out.slow;
    text + &table(
        &head,
        [
            row("gravity of the URDF", &held_out.gravity, gravity),
            row("inverse dynamics of the URDF", &held_out.urdf, urdf),
            row("the identified arm", &held_out.identified, identified),
        ],
    )
}

/// The call of libfranka's `setLoad`: mass, centre in the flange's frame, inertia about the centre column by column.
fn set_load(found: &IdentifiedArm) -> String {
    let payload = &found.payload;
    let [x, y, z] = payload.com_m.map(|axis| axis.value);
    let inertia = payload.inertia_kg_m2.map(|row| row.map(|own| format!("{own:.6}")).join(", "));
    let inertia = inertia.join(", ");
    format!("setLoad({:.4}, {{{x:.4}, {y:.4}, {z:.4}}}, {{{inertia}}})", payload.mass_kg.value)
}

/// The call of URScript's `set_target_payload`: mass, centre in the flange's frame, inertia xx, yy, zz, xy, xz, yz.
fn set_payload(found: &IdentifiedArm) -> String {
    let payload = &found.payload;
    let [x, y, z] = payload.com_m.map(|axis| axis.value);
    let i = payload.inertia_kg_m2;
    let inertia = [i[0][0], i[1][1], i[2][2], i[0][1], i[0][2], i[1][2]];
    let inertia = inertia.map(|own| format!("{own:.6}")).join(", ");
    format!(
        "set_target_payload({:.4}, [{x:.4}, {y:.4}, {z:.4}], [{inertia}])",
        payload.mass_kg.value
    )
}
