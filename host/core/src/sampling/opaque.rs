//! Splats that are so transparent that nobody sees a surface in them: floaters, which would take samples from
//! what is seen. They are left out of P_S, as vertices without a position are, and are deformed like all others.

use simod_model::{Error, ErrorKind, Model, Result, VertexChunk, follow};

/// Splats of less opacity are left out, where nothing else is asked for.
pub const LEAST_OPACITY: f64 = 0.1;

/// Which splats are left out of a model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Opaque {
    /// Where among the attributes the opacity is.
    place: usize,
    /// The least one, before the sigmoid, as files have it.
    least: f64,
}

impl Opaque {
    /// Of this opacity at least; nothing where none is asked for, or the model has no splats.
    pub(crate) fn of(model: &dyn Model, least: Option<f64>) -> Option<Self> {
        let least = least.filter(|least| *least > 0.0)?;
        let place = follow::opacity(&model.info().attributes)?;
        Some(Self { place, least: (least / (1.0 - least)).ln() })
    }

    /// Takes the positions from the splats of a chunk that are left out; returns how many of them had one.
    ///
    /// # Errors
    /// In a text format, something is no number.
    pub(crate) fn leave_out(&self, model: &dyn Model, chunk: &mut VertexChunk) -> Result<u64> {
        let mut opacity = [Vec::new()];
        model.some_attributes(chunk, &[self.place], &mut opacity)?;
        let mut count = 0;
        for (p, opacity) in chunk.positions.iter_mut().zip(&opacity[0]) {
            // What is no number stays.
            if *opacity < self.least && p.is_finite() {
                *p = glam::DVec3::NAN;
                count += 1;
            }
        }
        Ok(count)
    }
}

/// The least opacity of a model's splats, by what was asked for: nothing where there are none.
///
/// # Errors
/// It is none from 0 to 1, or there is nothing of which it could be.
pub(super) fn resolve(model: &dyn Model, asked: Option<f64>) -> Result<Option<f64>> {
    let refused = |what: String, hint: &str| Err(Error::new(ErrorKind::Argument, what, hint));
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
