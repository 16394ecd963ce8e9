//! State and figures of a session as ROS diagnostics.

use crate::figures::SessionFigures;
use crate::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Stamp};
use crate::session::SessionState;

const OK: u8 = 0;
const WARNING: u8 = 1;
const ERROR: u8 = 2;
/// Time without a joint state after which a warning is published, s.
const SILENT_S: f64 = 1.0;

/// Figures as a diagnostic message.
pub(crate) fn of(figures: &SessionFigures, robot: &str, header: Header) -> DiagnosticArray {
    let (level, message) = if let Some(cause) = &figures.stop {
        (ERROR, format!("the robot must stop: {cause}"))
    } else if figures.silent_s > SILENT_S {
        (WARNING, format!("no joint state came for {:.0} s", figures.silent_s))
    } else if figures.state == SessionState::Waiting {
        (WARNING, "waiting for the arm to pause, free of the object".to_owned())
    } else if figures.dropped + figures.lost > 0 {
        (WARNING, format!("{} samples dropped, {} never came", figures.dropped, figures.lost))
    } else {
        (OK, "maps".to_owned())
    };
    let optional = |number: Option<f64>| number.map_or("-".to_owned(), |x| format!("{x:.3}"));
    let values = [
        ("rate, Hz", format!("{:.0}", figures.rate_hz)),
        ("latency (median), ms", format!("{:.2}", figures.latency_ms.median)),
        ("latency (99 of 100), ms", format!("{:.2}", figures.latency_ms.p99)),
        ("step (median), ms", format!("{:.2}", figures.step_ms.median)),
        ("replays a sample", format!("{:.1}", figures.replays)),
        ("samples received", figures.received.to_string()),
        ("samples dropped", figures.dropped.to_string()),
        ("samples that never came", figures.lost.to_string()),
        ("messages refused", figures.refused.values().sum::<u64>().to_string()),
        ("messages unsent", figures.unsent.to_string()),
        ("points touched", figures.contacts.to_string()),
        ("cells touched so far", figures.cells.to_string()),
        ("average error, N m", optional(figures.avg_error)),
        ("average error of predicting zero, N m", optional(figures.zero_avg_error)),
        ("age of the checkpoint, s", optional(figures.checkpoint_s)),
    ];
    let values = values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value });
    let status = DiagnosticStatus {
        level,
        name: "palpate: stiffness mapping".to_owned(),
        message,
        hardware_id: robot.to_owned(),
        values: values.collect(),
    };
    DiagnosticArray { header, status: vec![status] }
}

/// The guard's flag, and the cause if it is up, as a diagnostic message.
pub(crate) fn of_guard(cause: Option<&str>, stamp: Stamp) -> DiagnosticArray {
    let (level, message) = match cause {
        Some(cause) => (ERROR, cause.to_owned()),
        None => (OK, "no reason to stop the robot".to_owned()),
    };
    let status = DiagnosticStatus {
        level,
        name: "palpate: guard".to_owned(),
        message,
        hardware_id: String::new(),
        values: vec![KeyValue { key: "stop".to_owned(), value: cause.is_some().to_string() }],
    };
    let header = Header { stamp, ..Header::default() };
    DiagnosticArray { header, status: vec![status] }
}
