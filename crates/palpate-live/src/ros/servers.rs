//! palpate's services: take a tare, reset the guard, save the field, predict torques along a trajectory.

use std::io;

use ros2_client::service::RmwRequestId;
use ros2_client::service::Server;
use ros2_client::{Message, QosProfile, ServiceTypeName};
use rustdds::mio1::{Interest, Registry, Token};

use super::network::{Network, NetworkError, parse};
use super::parameters::{Parameter, Parameters};
use super::wire::{FromNetwork, PendingRequest, Request, Response, Trigger};
use crate::message::{
    AskTrajectoryRequest, AskTrajectoryResponse, JointTrajectory, TriggerRequest, TriggerResponse,
};

/// Largest number of points of a trajectory; longer requests are refused. Its answer takes half a megabyte.
const MAX_POINTS: usize = 2_000;
/// Largest number of joints of a trajectory.
const MAX_JOINTS: usize = 64;

/// The servers of all services.
pub(super) struct Servers {
    triggers: Vec<(Trigger, Server<TriggerRequest, TriggerResponse>)>,
    ask: Server<AskTrajectoryRequest, AskTrajectoryResponse>,
    parameters: Parameters,
}

impl Network {
    /// Offers the services, and those of the node's parameters.
    ///
    /// # Errors
    ///
    /// If DDS refuses.
    pub(super) fn serve_all(
        &mut self,
        parameters: Vec<Parameter>,
    ) -> Result<Servers, NetworkError> {
        let trigger = |trigger: Trigger| {
            let name = self.names.of(trigger.name());
            Ok((trigger, self.serve(&name, "std_srvs", "Trigger")?))
        };
        let triggers: Result<_, NetworkError> = Trigger::ALL.into_iter().map(trigger).collect();
        let ask = self.names.of("/palpate/ask");
        Ok(Servers {
            triggers: triggers?,
            ask: self.serve(&ask, "palpate_ros", "AskTrajectory")?,
            parameters: self.parameters(parameters)?,
        })
    }

    /// Offers a service.
    pub(super) fn serve<Q: Message + Clone + 'static, A: Message + Clone + 'static>(
        &mut self,
        service: &str,
        package: &str,
        kind: &str,
    ) -> Result<Server<Q, A>, NetworkError> {
        let reliable = QosProfile::publisher_default();
        let served = self.node.create_server(
            self.services.mapping(),
            &parse(service)?,
            &ServiceTypeName::new(package, kind),
            reliable.clone(),
            reliable,
        );
        served.map_err(|error| NetworkError::open(service, &error))
    }
}

impl Servers {
    /// Registers all services with a poll, which wakes for requests.
    pub(super) fn register(&mut self, registry: &Registry, token: Token) -> io::Result<()> {
        for (_, server) in &mut self.triggers {
            registry.register(server, token, Interest::READABLE)?;
        }
        registry.register(&mut self.ask, token, Interest::READABLE)?;
        self.parameters.register(registry, token)
    }

    /// Hands on all waiting requests; those for parameters are answered here.
    pub(super) fn receive(&self, mut hand_on: impl FnMut(FromNetwork)) {
        for (trigger, server) in &self.triggers {
            while let Ok(Some((id, _))) = server.receive_request() {
                hand_on(FromNetwork::Asked(PendingRequest {
                    request: Request::Trigger(*trigger),
                    id,
                }));
            }
        }
        while let Ok(Some((id, mut request))) = self.ask.receive_request() {
            match bounded(&mut request.trajectory) {
                Ok(()) => {
                    let request = Request::Trajectory(Box::new(request));
                    hand_on(FromNetwork::Asked(PendingRequest { request, id }));
                }
                Err(message) => {
                    let refused =
                        AskTrajectoryResponse { message, ..AskTrajectoryResponse::default() };
                    self.answer(id, Response::Trajectory(Box::new(refused)));
                }
            }
        }
        self.parameters.answer();
    }

    /// Answers a request; failures are ignored, since the client may have disconnected.
    pub(super) fn answer(&self, id: RmwRequestId, response: Response) {
        match response {
            Response::Trigger(trigger, response) => {
                let server = self.triggers.iter().find(|(other, _)| *other == trigger);
                let _ = server.map(|(_, server)| server.send_response(id, response));
            }
            Response::Trajectory(response) => drop(self.ask.send_response(id, *response)),
        }
    }
}

/// Checks the size of a trajectory, and removes the values that are not used.
///
/// # Errors
///
/// If the trajectory is too large, or a point has not one position for each joint name.
fn bounded(trajectory: &mut JointTrajectory) -> Result<(), String> {
    let (points, joints) = (trajectory.points.len(), trajectory.joint_names.len());
    if points > MAX_POINTS || joints > MAX_JOINTS {
        return Err(format!(
            "the trajectory has {points} points of {joints} joints, more than {MAX_POINTS} of {MAX_JOINTS}; \
             divide it and ask about each part"
        ));
    }
    for (number, point) in trajectory.points.iter_mut().enumerate() {
        if point.positions.len() != joints {
            return Err(format!(
                "point {number} (from 0) has {} positions for {joints} joint names",
                point.positions.len()
            ));
        }
        (point.velocities, point.accelerations, point.effort) = (vec![], vec![], vec![]);
    }
    Ok(())
}
