//! What shows the shape of an object, for a command that learns its elastic body.

use std::path::PathBuf;
use std::sync::Arc;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use palpate::EstimatorKind;
use palpate::unstable::ElasticBody;
use palpate_learn::body::Shape;
use palpate_work::elastic::without_body;

use crate::cloud_args::CloudArgs;
use crate::error::CliError;
use crate::output::Output;
use crate::place::Places;
use crate::settings::Settings;

/// A cloud of the object, or its body.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct ShapeArgs {
    /// Coloured cloud of the object (PLY, PCD), or the folder of a picture with depth, in the world frame:
    /// learn an elastic body as well
    #[arg(long, value_name = "CLOUD")]
    cloud: Option<PathBuf>,
    /// An elastic body in place of a cloud: the file that `palpate convert` wrote, perhaps corrected by hand
    #[arg(long, value_name = "BODY.json", conflicts_with = "cloud")]
    body: Option<PathBuf>,
    /// What the cloud shows, if palpate does not find it: `plant` (stems, branches, leaves) or `cushion`
    /// (anything else that gives way)
    #[arg(long, value_name = "KIND", requires = "cloud", value_parser = object())]
    object: Option<Shape>,
    #[command(flatten)]
    cloud_args: CloudArgs,
}

/// A parser of kinds of objects.
pub(crate) fn object() -> impl TypedValueParser<Value = Shape> {
    PossibleValuesParser::new(["plant", "cushion"]).map(|name| match &*name {
        "plant" => Shape::Plant,
        _ => Shape::Cushion,
    })
}

impl ShapeArgs {
    /// Whether there is one.
    pub(crate) fn is_given(&self) -> bool {
        self.cloud.is_some() || self.body.is_some()
    }

    /// Adds what is read.
    pub(crate) fn add_to(&self, places: &mut Places) {
        places.input("the cloud (--cloud)", self.cloud.as_deref());
        places.input("the body (--body)", self.body.as_deref());
    }

    /// Selects the estimator `elastic` if a shape is given; refuses it without one, unless a `field` to go on
    /// from may bring its body.
    pub(crate) fn select(&self, settings: &mut Settings, field: bool) -> Result<(), CliError> {
        let estimator = &mut settings.estimator.estimator;
        match *estimator {
            None if self.is_given() => *estimator = Some(EstimatorKind::Elastic),
            Some(EstimatorKind::Elastic) if !self.is_given() && !field => {
                return Err(without_body().into());
            }
            Some(other) if self.is_given() && other != EstimatorKind::Elastic => {
                return Err(CliError::Usage(format!(
                    "--cloud and --body are for the estimator elastic, and --estimator is {}; leave one \
                     of them out",
                    other.name()
                )));
            }
            _ => {}
        }
        Ok(())
    }

    /// The bodies that the object may be; none if the cloud shows none.
    pub(crate) fn bodies(&self, output: &Output) -> Result<Vec<Arc<ElasticBody>>, CliError> {
        let (cloud, body) = (self.cloud.as_deref(), self.body.as_deref());
        Ok(self.cloud_args.bodies((cloud, self.object), body, output)?.0)
    }
}
