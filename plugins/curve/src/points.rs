//! The points of a wire: of a file, or along the middle of the model.

use glam::DVec3;
use simod_plugin_api::{Bounds, PluginError, PluginResult};
use std::path::Path;

/// Most points of a wire.
pub const MOST: usize = 1000;
/// Most bytes of a file.
const MOST_BYTES: u64 = 4 << 20;

/// Points of a file, in the file's coordinates: lines of three numbers, separated by commas, semicolons or
/// white space; a first line without numbers is a heading. OBJ files have vertices, in the order of their
/// first `l` line where there is one.
///
/// # Errors
/// The file cannot be read, a line is no point, or there are fewer than two points or more than [`MOST`].
pub fn read(path: &Path) -> PluginResult<Vec<DVec3>> {
    let error = |what: String| {
        PluginError::input(format!("{}{what}", path.display()))
            .hint("a line for each point along the wire: x, y, z in the model's coordinates")
    };
    let unreadable = |e: std::io::Error| error(format!(" cannot be read: {e}"));
    if std::fs::metadata(path).map_err(unreadable)?.len() > MOST_BYTES {
        return Err(error(" is too large for a wire".to_owned()));
    }
    let bytes = std::fs::read(path).map_err(unreadable)?;
    let text = std::str::from_utf8(&bytes).map_err(|_| error(" is no text".to_owned()))?;
    let text = text.trim_start_matches('\u{feff}');
    let is_obj = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
    let points = if is_obj { of_obj(text) } else { of_lines(text) };
    let points = points.map_err(|(line, what)| error(format!(", line {line} {what}")))?;
    match points.len() {
        0 | 1 => Err(error(format!(" has {} points; a wire has two at least", points.len()))),
        n if n > MOST => Err(error(format!(" has {n} points; {MOST} are the most"))),
        _ => Ok(points),
    }
}

/// Line of a defect, and the defect.
type BadPoints = (usize, String);

fn of_lines(text: &str) -> Result<Vec<DVec3>, BadPoints> {
    let mut points = Vec::new();
    let mut is_first = true;
    for (line, text) in (1..).zip(text.lines()) {
        let text = text.split('#').next().unwrap_or_default();
        let fields: Vec<&str> =
            text.split(|c: char| ",;".contains(c) || c.is_whitespace()).filter(|f| !f.is_empty()).collect();
        if fields.is_empty() {
            continue;
        }
        let may_be_heading = std::mem::replace(&mut is_first, false);
        if may_be_heading && fields.iter().all(|f| f.parse::<f64>().is_err()) {
            continue;
        }
        points.push(point(&fields).map_err(|what| (line, what))?);
    }
    Ok(points)
}

fn of_obj(text: &str) -> Result<Vec<DVec3>, BadPoints> {
    let (mut vertices, mut order) = (Vec::new(), None);
    for (line, text) in (1..).zip(text.lines()) {
        let mut fields = text.split_whitespace();
        match fields.next() {
            Some("v") => {
                // Coordinates may be followed by a weight or a colour.
                let fields: Vec<&str> = fields.take(3).collect();
                vertices.push(point(&fields).map_err(|what| (line, what))?);
            }
            Some("l") if order.is_none() => {
                let index = |field: &str| -> Result<usize, BadPoints> {
                    let number = field.split('/').next().unwrap_or_default().parse::<i64>();
                    let wrong = || (line, format!("names `{field}`, which is no vertex before it"));
                    let index = match number.map_err(|_| wrong())? {
                        i if i < 0 => vertices.len() as i64 + i,
                        i => i - 1,
                    };
                    usize::try_from(index).ok().filter(|i| *i < vertices.len()).ok_or_else(wrong)
                };
                order = Some(fields.map(index).collect::<Result<Vec<usize>, BadPoints>>()?);
            }
            _ => {}
        }
    }
    Ok(match order {
        Some(order) => order.into_iter().map(|i| vertices[i]).collect(),
        None => vertices,
    })
}

fn point(fields: &[&str]) -> Result<DVec3, String> {
    let [x, y, z] = fields else {
        return Err(format!("has {} fields, not the three of a point", fields.len()));
    };
    let number = |field: &&str| match field.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        Ok(_) => Err(format!("has `{field}`, which is not finite")),
        Err(_) => Err(format!("has `{field}`, which is no number")),
    };
    Ok(DVec3::new(number(x)?, number(y)?, number(z)?))
}

/// Points through the model along the longest side of its box, evenly apart: each in the middle of the
/// samples around it.
pub fn along_the_middle(bounds: &Bounds, samples: &[[f32; 3]], points: usize) -> Vec<DVec3> {
    let [low, high] = [bounds.min, bounds.max].map(DVec3::from);
    let size = high - low;
    let axis = size.max_position();
    let step = size[axis] / (points - 1) as f64;
    let mut sums = vec![(DVec3::ZERO, 0.0); points];
    for p in samples.iter().map(|p| DVec3::from(p.map(f64::from))) {
        // Samples between two points count for both.
        let place =
            if step > 0.0 { ((p[axis] - low[axis]) / step).clamp(0.0, (points - 1) as f64) } else { 0.0 };
        let before = (place as usize).min(points - 2);
        for (point, weight) in [(before, before as f64 + 1.0 - place), (before + 1, place - before as f64)] {
            sums[point].0 += weight * p;
            sums[point].1 += weight;
        }
    }
    let mut middle = low.midpoint(high);
    let along = (0..points).zip(sums).map(|(i, (sum, weight))| {
        // Without samples around it, a point has the middle of the one before.
        middle = if weight > 0.0 { sum / weight } else { middle };
        middle[axis] = low[axis] + i as f64 * step;
        middle
    });
    along.collect()
}
