//! Flags that give an object's cloud or body, for commands that learn an elastic body.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::EstimatorKind;
use palpate::unstable::ElasticBody;
use palpate_io::cloud::Cloud;
use palpate_learn::body::{ObjectHints, ObjectKind};
use palpate_work::elastic::without_body;
use palpate_work::settings::{named, vector3};

use crate::cloud_args::CloudArgs;
use crate::error::CliError;
use crate::file_paths::FilePaths;
use crate::output::Output;
use crate::settings::Settings;

/// A cloud of the object, or its body.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct ObjectArgs {
    /// Coloured cloud of the object (PLY, PCD), or the folder of a picture with depth, in the world frame:
    /// also learn an elastic body. Repeat the flag for each further camera
    #[arg(id = "cloud", long, value_name = "CLOUD")]
    clouds: Vec<PathBuf>,
    /// File of an elastic body, in place of one made from the cloud: written by `palpate convert`, perhaps
    /// corrected by hand. `evaluate` also accepts both, and shows the cloud in its report
    #[arg(long, value_name = "BODY.json")]
    body: Option<PathBuf>,
    /// What the cloud shows: `plant` (stems, branches, leaves) or `cushion` (any other soft object)
    /// [default: found from the cloud]
    #[arg(long, value_name = "KIND", requires = "cloud", conflicts_with = "body", value_parser = named::<ObjectKind>(&ObjectKind::WORDS))]
    object_kind: Option<ObjectKind>,
    /// Point at which a plant is fixed, m, world frame; repeat the flag for each further plant
    /// [default: where stems meet the ground]
    #[arg(id = "root", long, value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true, requires = "cloud", conflicts_with = "body")]
    roots_m: Vec<[f64; 3]>,
    #[command(flatten)]
    cloud_args: CloudArgs,
}

/// Three finite numbers.
fn place(text: &str) -> Result<[f64; 3], String> {
    let place = vector3(text)?;
    let is_finite = place.iter().all(|along| along.is_finite());
    is_finite.then_some(place).ok_or_else(|| "wanted finite numbers, m".to_owned())
}

impl ObjectArgs {
    /// Whether a cloud or a body is given.
    pub(crate) fn is_given(&self) -> bool {
        !self.clouds.is_empty() || self.body.is_some()
    }

    /// Adds the cloud and the body to the files that are read.
    pub(crate) fn add_to(&self, places: &mut FilePaths) {
        for cloud in &self.clouds {
            places.input("the cloud (--cloud)", Some(cloud));
        }
        places.input("the body (--body)", self.body.as_deref());
    }

    /// Selects the estimator `elastic` if an object is given; refuses this estimator without an object, unless
    /// mapping continues from a `field`, which may contain a body.
    pub(crate) fn select(&self, settings: &mut Settings, field: bool) -> Result<(), CliError> {
        if !self.clouds.is_empty() && self.body.is_some() {
            let both = "--cloud and --body both define the elastic body; leave one of them out";
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
                    "--cloud and --body are for the estimator elastic, but --estimator is {}; leave out \
                     --estimator, or --cloud and --body",
                    other.name()
                )));
            }
            _ => {}
        }
        Ok(())
    }

    /// The candidate bodies of the object, none if the cloud shows none; and the cloud, if one is given.
    pub(crate) fn bodies(
        &self,
        output: &Output,
    ) -> Result<(Vec<Arc<ElasticBody>>, Option<Cloud>), CliError> {
        let hints = ObjectHints {
            kind: self.object_kind,
            roots_m: self.roots_m.iter().map(|&root| root.into()).collect(),
        };
        self.cloud_args.bodies((&self.clouds, &hints), self.body.as_deref(), output)
    }
}
