//! Splats in which nobody sees a surface: floaters, which would take samples from the visible ones. They are
//! too transparent, the more so the larger or the farther off they are than others. They are left out of P_S,
//! as vertices without a position are, and are deformed like all others.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use simod_model::{Error, Model, Result, VertexChunk, follow};

/// Splats of less opacity are left out, where nothing else is asked for.
pub const LEAST_OPACITY: f64 = 0.1;

/// Ratio of a splat's size to the usual one, or of its distance, above which more opacity is needed in
/// proportion.
const UNUSUAL: f64 = 10.0;

/// Opacity from which on a splat is part of the visible surface, however large and wherever it is.
const SEEN: f64 = 0.5;

/// Numbers of places in the file at which splats are read to tell the usual ones, and of splats at each.
const PLACES: u64 = 64;
const AT_A_PLACE: u64 = 1024;

/// Medians of the splats of a model that are opaque enough, with which larger and farther ones are compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct UsualSplat {
    /// The median of positions, axis by axis.
    middle: DVec3,
    /// The median distance from there.
    distance: f64,
    /// The median size: the geometric mean of the two longest axes.
    size: f64,
}

impl UsualSplat {
    /// Medians of some splats, given by position and size; `None` if there are none, or a median is zero.
    fn median(splats: &[(DVec3, f64)]) -> Option<Self> {
        let median = |of: &dyn Fn(&(DVec3, f64)) -> f64| {
            let (mut numbers, middle) = (splats.iter().map(of).collect::<Vec<_>>(), splats.len() / 2);
            (!numbers.is_empty()).then(|| *numbers.select_nth_unstable_by(middle, f64::total_cmp).1)
        };
        let middle = DVec3::new(median(&|s| s.0.x)?, median(&|s| s.0.y)?, median(&|s| s.0.z)?);
        let usual = Self { middle, distance: median(&|s| s.0.distance(middle))?, size: median(&|s| s.1)? };
        (usual.distance > 0.0 && usual.size > 0.0).then_some(usual)
    }

    /// Factor by which a splat is larger or farther off than one that is hardly unusual; at least 1, and by
    /// the distance alone if it has no size.
    fn excess(&self, p: DVec3, size: f64) -> f64 {
        (size / (UNUSUAL * self.size)).max(p.distance(self.middle) / (UNUSUAL * self.distance)).max(1.0)
    }
}

/// The rule by which splats of a model are left out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Opaque {
    /// Places of the opacity and the logarithms of the scales among the attributes; discs have two scales.
    places: [usize; 4],
    scales: usize,
    /// The least opacity.
    least: f64,
    usual: Option<UsualSplat>,
}

impl Opaque {
    /// Splats of this opacity at least, and more where a splat is larger or farther off than `usual`; nothing
    /// where none is asked for, or the model has no splats.
    pub(crate) fn new(model: &dyn Model, least: Option<f64>, usual: Option<UsualSplat>) -> Option<Self> {
        let least = least.filter(|least| *least > 0.0)?;
        let attributes = &model.info().attributes;
        let mut places = [follow::opacity(attributes)?; 4];
        let scale = |i: usize| attributes.iter().position(|a| a.name == format!("scale_{i}"));
        let scales = (0..3).map_while(scale).zip(&mut places[1..]).map(|(scale, to)| *to = scale).count();
        Some(Self { places, scales, least, usual })
    }

    /// The rule for a model, with the size of splats that is found to be usual in it.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(crate) fn find(model: &dyn Model, least: Option<f64>) -> Result<Option<Self>> {
        let Some(opaque) = Self::new(model, least, None) else { return Ok(None) };
        Ok(Some(Self { usual: opaque.find_usual(model)?, ..opaque }))
    }

    /// Medians of splats, with which others are compared.
    pub(crate) fn usual(&self) -> Option<UsualSplat> {
        self.usual
    }

    /// Medians of the model's splats.
    ///
    /// # Errors
    /// The file cannot be read.
    fn find_usual(&self, model: &dyn Model) -> Result<Option<UsualSplat>> {
        let info = model.info();
        // All splats are read, and some are taken, where reading begins at the first one always: files may be
        // sorted.
        let (places, each, step) = match info.random_access && info.vertices > PLACES * AT_A_PLACE {
            true => (PLACES, AT_A_PLACE, 1),
            false => (1, info.vertices, info.vertices.div_ceil(PLACES * AT_A_PLACE).max(1)),
        };
        let read = |place: u64| -> Result<Vec<(DVec3, f64)>> {
            let first = info.vertices / places * place;
            let mut reader = model.vertices(first..first + each)?;
            let (mut chunk, mut numbers, mut splats) = (VertexChunk::default(), self.lists(), Vec::new());
            while reader.read(&mut chunk)? {
                model.some_attributes(&chunk, self.places(), &mut numbers)?;
                let all = (chunk.first..).zip(&chunk.positions).enumerate();
                let taken = all.filter(|(i, (splat, p))| {
                    splat.is_multiple_of(step) && p.is_finite() && numbers[0][*i] >= logit(self.least)
                });
                let sized = taken.map(|(i, (_, p))| (*p, size(&numbers[1..], i)));
                splats.extend(sized.filter(|(_, size)| size.is_finite()));
            }
            Ok(splats)
        };
        let splats = (0..places).into_par_iter().map(read).collect::<Result<Vec<_>>>()?;
        Ok(UsualSplat::median(&splats.concat()))
    }

    /// Takes the positions from the splats of a chunk that are left out; returns the number of those that had
    /// one.
    ///
    /// # Errors
    /// In a text format, something is no number.
    pub(crate) fn leave_out(&self, model: &dyn Model, chunk: &mut VertexChunk) -> Result<u64> {
        let mut numbers = self.lists();
        model.some_attributes(chunk, self.places(), &mut numbers)?;
        let (least, seen, mut count) = (logit(self.least), logit(SEEN.max(self.least)), 0);
        for (i, p) in chunk.positions.iter_mut().enumerate().filter(|(_, p)| p.is_finite()) {
            let opacity = numbers[0][i];
            let is_faint = |usual: UsualSplat| {
                opacity < seen && opacity < logit(self.least * usual.excess(*p, size(&numbers[1..], i)))
            };
            // A splat whose opacity is no number stays.
            if opacity < least || self.usual.is_some_and(is_faint) {
                *p = DVec3::NAN;
                count += 1;
            }
        }
        Ok(count)
    }

    fn places(&self) -> &[usize] {
        &self.places[..=self.scales]
    }

    fn lists(&self) -> Vec<Vec<f64>> {
        vec![Vec::new(); 1 + self.scales]
    }
}

/// The geometric mean of a splat's two longest axes, of the logarithms of their lengths.
fn size(scales: &[Vec<f64>], splat: usize) -> f64 {
    let (sum, least) = scales
        .iter()
        .fold((0.0, f64::INFINITY), |(sum, least), axis| (sum + axis[splat], axis[splat].min(least)));
    (0.5 * if scales.len() < 3 { sum } else { sum - least }).exp()
}

/// An opacity before the sigmoid, as files have it; of one that there cannot be, more than any.
fn logit(opacity: f64) -> f64 {
    if opacity < 1.0 { (opacity / (1.0 - opacity)).ln() } else { f64::INFINITY }
}

/// Least opacity of a model's splats, by the option; `None` where there are no splats, or none is left out.
///
/// # Errors
/// The opacity asked for is not from 0 to 1, or the model has no splats.
pub(super) fn resolve(model: &dyn Model, asked: Option<f64>) -> Result<Option<f64>> {
    let refused = |what: String, hint: &str| Err(Error::argument(what, hint));
    match asked {
        Some(least) if !(0.0..1.0).contains(&least) => refused(
            format!("the least opacity {least} is out of range"),
            "give one from 0, for all splats, to below 1",
        ),
        Some(_) if follow::opacity(&model.info().attributes).is_none() => refused(
            format!("{} has no splats with an opacity", model.path().display()),
            "leave out the least opacity: it is of Gaussian splats alone",
        ),
        _ if follow::opacity(&model.info().attributes).is_none() => Ok(None),
        asked => Ok(Some(asked.unwrap_or(LEAST_OPACITY)).filter(|least| *least > 0.0)),
    }
}
