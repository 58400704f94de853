//! The options on attributes that turn with the surface: the same for all commands that write deformed
//! models.

use std::collections::BTreeMap;

use clap::{Args, ValueEnum};
use simod_model::follow::{Follow, Opacity, TensorKind};

/// Options on attributes that turn with the surface.
#[derive(Args)]
pub struct FollowOptions {
    /// Attributes that turn with the surface, as tangent=vector,q=quaternion-wxyz
    ///
    /// NAME is what the names of an attribute's numbers begin with. KIND is vector, direction, normal,
    /// quaternion-wxyz, quaternion-xyzw or covariance. Gaussian splats are recognised and turn besides;
    /// `none` keeps all but positions and normals. [default: what the session declares, or MODEL.follow.toml
    /// beside the model, or splats alone]
    #[arg(long, value_name = "NAME=KIND,…")]
    follow: Option<Follow>,
    /// Opacity of Gaussian splats that are stretched
    #[arg(long, value_enum, default_value_t)]
    opacity: OpacityName,
    /// Largest ratio of length to width that a stretch gives a Gaussian splat, as 10
    ///
    /// Splats of a larger ratio before the deformation keep that. Without this option, any ratio may come
    /// about.
    #[arg(long, value_name = "N", value_parser = parse_anisotropy)]
    max_anisotropy: Option<f64>,
}

/// Treatment of the opacity of splats.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum OpacityName {
    /// Keep it: splats that are stretched with the surface cover as much of it as before
    #[default]
    Keep,
    /// Lower it where splats are stretched, as their matter is spread over more area
    Conserve,
}

impl FollowOptions {
    /// Attributes that follow the surface; the session's declaration holds where the command line gives
    /// none.
    pub fn follow(&self, declared: &BTreeMap<String, TensorKind>) -> Follow {
        let opacity = match self.opacity {
            OpacityName::Keep => Opacity::Keep,
            OpacityName::Conserve => Opacity::Conserve,
        };
        let follow = self.follow.clone().unwrap_or_default().or_declared(declared);
        Follow { opacity, max_anisotropy: self.max_anisotropy, ..follow }
    }
}

fn parse_anisotropy(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|n: &f64| *n >= 1.0 && n.is_finite());
    number.ok_or_else(|| "give a number of at least 1, as 10".to_owned())
}
