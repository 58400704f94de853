//! The colours of a model's vertices, in whatever type the file has them, as bytes.

use crate::{Model, Result, Type, VertexChunk};

/// Places of the model that are looked at for how its colours are meant, and vertices at each.
const PLACES: u64 = 16;
const AT_A_PLACE: u64 = 2048;

/// Where a model's colours are among its attributes, and how large they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Colors {
    places: [usize; 3],
    /// What makes bytes of them.
    scale: f64,
}

impl Colors {
    /// Those of a model with the attributes `red`, `green` and `blue`; nothing of one without.
    ///
    /// Colours of 16 bits are scaled, unless nothing in the file is above 255, as many programs write bytes
    /// there; floating-point ones are from 0 to 1, unless something is above. This is told by vertices all over
    /// the file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(model: &dyn Model) -> Result<Option<Self>> {
        let attributes = &model.info().attributes;
        let place = |name: &str| attributes.iter().position(|a| a.name == name);
        let (Some(r), Some(g), Some(b)) = (place("red"), place("green"), place("blue")) else {
            return Ok(None);
        };
        let mut colors = Self { places: [r, g, b], scale: 1.0 };
        if colors.places.iter().all(|place| attributes[*place].kind == Type::U8) {
            return Ok(Some(colors));
        }
        let is_float = colors.places.iter().any(|place| attributes[*place].kind.is_float());
        let (vertices, mut most) = (model.info().vertices, 0.0f64);
        // Where reading begins at the first vertex always, those there have to do.
        let places = if model.info().random_access { PLACES } else { 1 };
        let (mut chunk, mut lists) = (VertexChunk::default(), colors.lists());
        for i in 0..places {
            let first = vertices / places * i;
            let mut reader = model.vertices(first..(first + AT_A_PLACE).min(vertices))?;
            while reader.read(&mut chunk)? {
                model.attributes(&chunk, &mut lists)?;
                let all = colors.places.iter().flat_map(|place| &lists[*place]);
                most = all.filter(|c| c.is_finite()).fold(most, |most, c| most.max(*c));
            }
        }
        colors.scale = match most {
            _ if is_float && most <= 1.0 => 255.0,
            _ if most <= 255.0 => 1.0,
            _ => 255.0 / 65535.0,
        };
        Ok(Some(colors))
    }

    fn lists(&self) -> Vec<Vec<f64>> {
        vec![Vec::new(); self.places.iter().max().map_or(0, |last| last + 1)]
    }

    /// The colours of a chunk that was read from the model, red, green and blue; what `to` held is gone.
    ///
    /// # Errors
    /// In a text format, something is no number.
    pub fn decode(&self, model: &dyn Model, chunk: &VertexChunk, to: &mut Vec<[u8; 3]>) -> Result<()> {
        let mut lists = self.lists();
        model.attributes(chunk, &mut lists)?;
        // What is no number becomes 0.
        let byte = |place: usize, i: usize| (lists[place][i] * self.scale).round() as u8;
        to.clear();
        to.extend((0..chunk.len()).map(|i| self.places.map(|place| byte(place, i))));
        Ok(())
    }
}
