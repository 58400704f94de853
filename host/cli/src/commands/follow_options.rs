//! The options on attributes that turn with the surface: the same for all commands that write deformed
//! models.

use std::collections::BTreeMap;

use clap::{Args, ValueEnum};
use simod_model::follow::{Follow, Opacity, TensorKind};

/// The options on what turns besides positions and normals.
#[derive(Args)]
pub struct FollowOptions {
    /// Numbers of the vertices that turn with the surface, by what their names begin with, as
    /// tangent=vector,q=quaternion-wxyz: vector, direction, normal, quaternion-wxyz, quaternion-xyzw,
    /// covariance. Gaussian splats are recognised and turn besides; none keeps all but positions and normals
    /// [default: what the session declares, or MODEL.follow.toml beside the model, or splats alone]
    #[arg(long, value_name = "NAME=KIND,…")]
    follow: Option<Follow>,
    /// What becomes of the opacity of Gaussian splats
    #[arg(long, value_enum, default_value_t)]
    opacity: OpacityName,
    /// Gaussian splats become at most so many times as long as wide, unless they were before
    #[arg(long, value_name = "N", value_parser = parse_anisotropy)]
    max_anisotropy: Option<f64>,
}

/// Treatment of the opacity of splats.
#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum OpacityName {
    /// It stays, as where splats are stretched with the surface they cover as much of it
    #[default]
    Keep,
    /// Stretched ones become more transparent, as their matter is spread over more area
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
