//! What shows an object, for a command that learns its elastic body.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::EstimatorKind;
use palpate::unstable::ElasticBody;
use palpate_io::cloud::Cloud;
use palpate_learn::body::ObjectKind;
use palpate_work::elastic::without_body;
use palpate_work::settings::named;

use crate::cloud_args::CloudArgs;
use crate::error::CliError;
use crate::output::Output;
use crate::place::Places;
use crate::settings::Settings;

/// A cloud of the object, or its body.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct ObjectArgs {
    /// Coloured cloud of the object (PLY, PCD), or the folder of a picture with depth, in the world frame:
    /// learn an elastic body as well
    #[arg(long, value_name = "CLOUD")]
    cloud: Option<PathBuf>,
    /// An elastic body in place of one from the cloud: the file that `palpate convert` wrote, perhaps
    /// corrected by hand. `evaluate` also takes both, and shows the cloud in its report
    #[arg(long, value_name = "BODY.json")]
    body: Option<PathBuf>,
    /// What the cloud shows: `plant` (stems, branches, leaves) or `cushion` (anything else that gives
    /// way) [default: found from the cloud]
    #[arg(long, value_name = "KIND", requires = "cloud", conflicts_with = "body", value_parser = named::<ObjectKind>(&ObjectKind::WORDS))]
    object_kind: Option<ObjectKind>,
    #[command(flatten)]
    cloud_args: CloudArgs,
}

impl ObjectArgs {
    /// Whether there is one.
    pub(crate) fn is_given(&self) -> bool {
        self.cloud.is_some() || self.body.is_some()
    }

    /// Adds what is read.
    pub(crate) fn add_to(&self, places: &mut Places) {
        places.input("the cloud (--cloud)", self.cloud.as_deref());
        places.input("the body (--body)", self.body.as_deref());
    }

    /// Selects the estimator `elastic` if an object is given; refuses it without one, unless a `field` to go on
    /// from may bring its body.
    pub(crate) fn select(&self, settings: &mut Settings, field: bool) -> Result<(), CliError> {
        if self.cloud.is_some() && self.body.is_some() {
            let both = "--cloud and --body both say what the body is; leave one of them out";
            return Err(CliError::Usage(both.to_owned()));
        }
        let estimator = &mut settings.estimator.estimator;
        match *estimator {
            None if self.is_given() && !field => *estimator = Some(EstimatorKind::Elastic),
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

    /// The bodies that the object may be, none if the cloud shows none; and the cloud.
    pub(crate) fn bodies(
        &self,
        output: &Output,
    ) -> Result<(Vec<Arc<ElasticBody>>, Option<Cloud>), CliError> {
        let cloud = (self.cloud.as_deref(), self.object_kind);
        self.cloud_args.bodies(cloud, self.body.as_deref(), output)
    }
}
