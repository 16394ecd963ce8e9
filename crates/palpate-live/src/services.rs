//! The thread that answers the slow ROS services: saving the field, and torques along a trajectory.

use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use nalgebra::DVector;
use palpate::PathPoint;
use palpate_io::log::reorder;

use crate::message::{
    AskTrajectoryRequest, AskTrajectoryResponse, JointTrajectory, JointTrajectoryPoint,
    TriggerResponse,
};
use crate::query_server::{QueryServer, Request as ToMapper};
use crate::ros::{NetworkProcess, PendingRequest, Request, Response, ToNetwork};
use crate::threads::LOOK;

/// Largest number of requests that wait for an answer.
pub(crate) const REQUESTS: usize = 8;
/// Largest time to write the field, before the request is answered with an error.
const WRITING: Duration = Duration::from_secs(30);

/// Answers the requests.
pub(crate) struct ServiceHandler<'a> {
    /// Predicts torques; shared with the socket.
    pub(crate) queries: QueryServer<'a>,
    /// Names of the joints.
    pub(crate) joints: Vec<String>,
    /// Whether the field is saved to a file (`--output`).
    pub(crate) has_file: bool,
}

impl ServiceHandler<'_> {
    /// Answers requests until the session ends.
    pub(crate) fn run(&self, network: &NetworkProcess, asked: &Receiver<PendingRequest>) {
        while self.queries.shared.is_running() {
            match asked.recv_timeout(LOOK) {
                Ok(PendingRequest { request, id }) => {
                    let response = match request {
                        Request::Trigger(trigger) => Response::Trigger(trigger, self.save()),
                        Request::Trajectory(request) => {
                            Response::Trajectory(Box::new(self.trajectory(*request)))
                        }
                    };
                    network.send(&ToNetwork::Answer(id, response));
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Has the field written, and waits until this is done.
    fn save(&self) -> TriggerResponse {
        let done = match self.has_file {
            true => self.saved(),
            false => {
                Err("the field has no file: start palpate live with --output FIELD.npz".to_owned())
            }
        };
        let success = done.is_ok();
        TriggerResponse {
            success,
            message: done.err().unwrap_or_else(|| "the field is saved".to_owned()),
        }
    }

    fn saved(&self) -> Result<(), String> {
        let (shared, until) = (self.queries.shared, Instant::now() + WRITING);
        let mut number = None;
        while shared.is_running() && Instant::now() < until {
            match number {
                None => {
                    let (to_asker, from_mapper) = bounded(1);
                    let asked = self.queries.mapper.send(ToMapper::Save(to_asker));
                    asked.map_err(|_| "the mapper has stopped")?;
                    number = from_mapper.recv_timeout(WRITING).ok().flatten();
                }
                Some(number) => {
                    if let Some(result) = shared.written.result(number) {
                        return result;
                    }
                }
            }
            thread::sleep(LOOK);
        }
        Err("the field was not written in time".to_owned())
    }

    fn trajectory(&self, request: AskTrajectoryRequest) -> AskTrajectoryResponse {
        self.predicted(request).unwrap_or_else(|message| AskTrajectoryResponse {
            message,
            ..AskTrajectoryResponse::default()
        })
    }

    /// Predicts the torques along a trajectory.
    fn predicted(&self, request: AskTrajectoryRequest) -> Result<AskTrajectoryResponse, String> {
        let AskTrajectoryRequest { trajectory, level } = request;
        if !(0.0..1.0).contains(&level) {
            return Err(format!(
                "`level` is {level}; wanted 0 for the field's default, or a level below 1"
            ));
        }
        let path = self.path(&trajectory)?;
        let answer = self.queries.predict(path, false)?;
        let calibration = answer.calibration.as_deref();
        let level = match (calibration, level) {
            (None, level) if level > 0.0 => {
                return Err("the predictions of this field have no bands".to_owned());
            }
            (None, _) => 0.0,
            (Some(_), level) if level > 0.0 => level,
            (Some(own), _) => own.default_level(),
        };
        let torques = answer.points.iter().map(|point| &point.torque);
        let peak = torques.clone().map(|torque| torque.amax()).fold(0.0, f64::max);
        let (half_width, peak_with_band) = match calibration {
            None => (None, peak),
            Some(own) => {
                let no = || {
                    format!("`level` is {level}; the field has bands up to {}", own.highest_level())
                };
                let widths = answer.peak_half_width(level).ok_or_else(no)?;
                let outer =
                    torques.clone().zip(&widths).map(|(own, width)| (own.abs() + width).max());
                (answer.half_width(level), outer.fold(0.0, f64::max))
            }
        };
        let count = |of: fn(&PathPoint) -> usize| {
            answer.points.iter().map(|point| u32::try_from(of(point)).unwrap_or(u32::MAX)).collect()
        };
        Ok(AskTrajectoryResponse {
            success: true,
            message: String::new(),
            peak,
            peak_with_band,
            predicted: self.with_efforts(&trajectory, torques),
            half_width: half_width.map_or_else(JointTrajectory::default, |widths| {
                self.with_efforts(&trajectory, &widths)
            }),
            level,
            contacts: count(|point| point.contacts),
            known: count(|point| point.known),
            goes_on: answer.goes_on,
        })
    }

    /// Positions at each point, in the robot's order of joints. Every point has as many positions as there
    /// are joint names: the network process has checked it.
    fn path(&self, trajectory: &JointTrajectory) -> Result<Vec<Vec<f64>>, String> {
        let names = &trajectory.joint_names;
        let order = reorder(&self.joints, names).map_err(|error| error.to_string())?;
        let point = |point: &JointTrajectoryPoint| {
            order.iter().map(|&place| point.positions[place]).collect()
        };
        Ok(trajectory.points.iter().map(point).collect())
    }

    /// A trajectory in the robot's order of joints, with these efforts, one vector for each point.
    fn with_efforts<'a>(
        &self,
        trajectory: &JointTrajectory,
        efforts: impl IntoIterator<Item = &'a DVector<f64>>,
    ) -> JointTrajectory {
        let order = reorder(&self.joints, &trajectory.joint_names).unwrap_or_default();
        let point =
            |(point, effort): (&JointTrajectoryPoint, &DVector<f64>)| JointTrajectoryPoint {
                positions: order.iter().map(|&place| point.positions[place]).collect(),
                effort: effort.as_slice().to_vec(),
                time_from_start: point.time_from_start,
                ..JointTrajectoryPoint::default()
            };
        JointTrajectory {
            header: trajectory.header.clone(),
            joint_names: self.joints.clone(),
            points: trajectory.points.iter().zip(efforts).map(point).collect(),
        }
    }
}
