//! The parameters of the node, for `ros2 param`. They show how palpate was started and cannot be changed.

use ros2_client::parameters::raw::{
    Parameter as RawParameter, ParameterDescriptor, ParameterType, ParameterValue,
    SetParametersResult,
};
use ros2_client::rcl_interfaces::{
    DescribeParametersRequest, DescribeParametersResponse, GetParameterTypesRequest,
    GetParameterTypesResponse, GetParametersRequest, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, ListParametersResult, SetParametersAtomicallyResponse,
    SetParametersRequest, SetParametersResponse,
};
use ros2_client::service::Server;
use rustdds::mio1::{Interest, Registry, Token};
use serde::{Deserialize, Serialize};

use super::network::{Network, NetworkError};

/// Largest number of parameters in an answer.
const MOST: usize = 256;

/// Value of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)] // the types are the names
pub enum ParamValue {
    Bool(bool),
    Number(f64),
    Text(String),
}

/// A parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name of the parameter.
    pub name: String,
    /// Its value.
    pub value: ParamValue,
    /// Description for the user.
    pub about: String,
}

/// The parameters, and the services that answer requests for them.
pub(super) struct Parameters {
    all: Vec<Parameter>,
    get: Server<GetParametersRequest, GetParametersResponse>,
    types: Server<GetParameterTypesRequest, GetParameterTypesResponse>,
    list: Server<ListParametersRequest, ListParametersResponse>,
    describe: Server<DescribeParametersRequest, DescribeParametersResponse>,
    set: Server<SetParametersRequest, SetParametersResponse>,
    set_atomically: Server<SetParametersRequest, SetParametersAtomicallyResponse>,
}

impl Network {
    /// Offers the six services of a node's parameters.
    ///
    /// # Errors
    ///
    /// If DDS refuses.
    pub(super) fn parameters(&mut self, all: Vec<Parameter>) -> Result<Parameters, NetworkError> {
        let (package, node) = ("rcl_interfaces", self.node.fully_qualified_name());
        let at = |service: &str| format!("{node}/{service}");
        Ok(Parameters {
            all,
            get: self.serve(&at("get_parameters"), package, "GetParameters")?,
            types: self.serve(&at("get_parameter_types"), package, "GetParameterTypes")?,
            list: self.serve(&at("list_parameters"), package, "ListParameters")?,
            describe: self.serve(&at("describe_parameters"), package, "DescribeParameters")?,
            set: self.serve(&at("set_parameters"), package, "SetParameters")?,
            set_atomically: self.serve(
                &at("set_parameters_atomically"),
                package,
                "SetParametersAtomically",
            )?,
        })
    }
}

impl Parameters {
    /// Registers all services with a poll, which wakes for requests.
    pub(super) fn register(&mut self, registry: &Registry, token: Token) -> std::io::Result<()> {
        let readable = Interest::READABLE;
        registry.register(&mut self.get, token, readable)?;
        registry.register(&mut self.types, token, readable)?;
        registry.register(&mut self.list, token, readable)?;
        registry.register(&mut self.describe, token, readable)?;
        registry.register(&mut self.set, token, readable)?;
        registry.register(&mut self.set_atomically, token, readable)
    }

    /// Answers all waiting requests. Failures are ignored: a client may have disconnected.
    pub(super) fn answer(&self) {
        while let Ok(Some((id, asked))) = self.get.receive_request() {
            let values = self.each(&asked.names, raw);
            let _ = self.get.send_response(id, GetParametersResponse { values });
        }
        while let Ok(Some((id, asked))) = self.types.receive_request() {
            let values = self.each(&asked.names, |found| raw(found).ptype);
            let _ = self.types.send_response(id, GetParameterTypesResponse { values });
        }
        while let Ok(Some((id, asked))) = self.list.receive_request() {
            let result = self.listed(&asked);
            let _ = self.list.send_response(id, ListParametersResponse { result });
        }
        while let Ok(Some((id, asked))) = self.describe.receive_request() {
            let values = asked
                .names
                .iter()
                .take(MOST)
                .map(|name| descriptor(name, self.find(name)))
                .collect();
            let _ = self.describe.send_response(id, DescribeParametersResponse { values });
        }
        while let Ok(Some((id, asked))) = self.set.receive_request() {
            let results =
                asked.parameter.iter().take(MOST).map(|wanted| self.set(wanted)).collect();
            let _ = self.set.send_response(id, SetParametersResponse { results });
        }
        while let Ok(Some((id, asked))) = self.set_atomically.receive_request() {
            let done = SetParametersResult { successful: true, reason: String::new() };
            let mut results = asked.parameter.iter().map(|wanted| self.set(wanted));
            let result = results.find(|result| !result.successful).unwrap_or(done);
            let _ =
                self.set_atomically.send_response(id, SetParametersAtomicallyResponse { result });
        }
    }

    fn find(&self, name: &str) -> Option<&Parameter> {
        self.all.iter().find(|parameter| parameter.name == name)
    }

    /// Applies `of` to the value of each named parameter, for at most [`MOST`] names.
    fn each<T>(&self, names: &[String], of: impl Fn(Option<&ParamValue>) -> T) -> Vec<T> {
        let names = names.iter().take(MOST);
        names.map(|name| of(self.find(name).map(|found| &found.value))).collect()
    }

    /// The parameters that match the prefixes of a request. Their names have no parts, so a prefix is a
    /// whole name.
    fn listed(&self, asked: &ListParametersRequest) -> ListParametersResult {
        let names = self.all.iter().map(|parameter| parameter.name.clone());
        let is_asked = |name: &String| asked.prefixes.is_empty() || asked.prefixes.contains(name);
        ListParametersResult { names: names.filter(is_asked).collect(), prefixes: Vec::new() }
    }

    /// Succeeds only if the parameter already has the wanted value: it cannot be changed.
    fn set(&self, wanted: &RawParameter) -> SetParametersResult {
        let name = &wanted.name;
        let reason = match self.find(name) {
            None => format!("palpate has no parameter `{name}`"),
            Some(found) if found.value.is(&wanted.value) => String::new(),
            Some(_) => {
                format!(
                    "`{name}` cannot be changed while palpate runs: it is a flag of `palpate live`"
                )
            }
        };
        SetParametersResult { successful: reason.is_empty(), reason }
    }
}

impl ParamValue {
    /// Whether a message contains this value.
    fn is(&self, raw: &ParameterValue) -> bool {
        match self {
            Self::Bool(value) => raw.ptype == ParameterType::BOOL && raw.boolean_value == *value,
            Self::Number(value) => raw.ptype == ParameterType::DOUBLE && raw.double_value == *value,
            Self::Text(value) => raw.ptype == ParameterType::STRING && raw.string_value == *value,
        }
    }
}

/// The message for a value, or for no value.
fn raw(value: Option<&ParamValue>) -> ParameterValue {
    let mut raw = ParameterValue {
        ptype: ParameterType::NOT_SET,
        boolean_value: false,
        int_value: 0,
        double_value: 0.0,
        string_value: String::new(),
        byte_array: Vec::new(),
        bool_array: Vec::new(),
        int_array: Vec::new(),
        double_array: Vec::new(),
        string_array: Vec::new(),
    };
    match value {
        None => {}
        Some(ParamValue::Bool(value)) => {
            (raw.ptype, raw.boolean_value) = (ParameterType::BOOL, *value)
        }
        Some(ParamValue::Number(value)) => {
            (raw.ptype, raw.double_value) = (ParameterType::DOUBLE, *value)
        }
        Some(ParamValue::Text(value)) => {
            (raw.ptype, raw.string_value) = (ParameterType::STRING, value.clone());
        }
    }
    raw
}

fn descriptor(name: &str, found: Option<&Parameter>) -> ParameterDescriptor {
    ParameterDescriptor {
        name: name.to_owned(),
        r#type: raw(found.map(|found| &found.value)).ptype,
        description: found.map_or_else(String::new, |found| found.about.clone()),
        additional_constraints: String::new(),
        read_only: true,
        dynamic_typing: false,
        floating_point_range: Vec::new(),
        integer_range: Vec::new(),
    }
}
