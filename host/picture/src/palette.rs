//! Colours that stand for numbers.

/// Colours from the least to the largest number: light to dark, so that they are told apart in print and by
/// everybody.
const SCALE: [[u8; 3]; 6] =
    [[216, 216, 212], [248, 222, 140], [245, 160, 60], [222, 80, 50], [160, 25, 80], [60, 10, 85]];

/// Colours of the classes of the LAS specification (ASPRS, LAS 1.4 R15, table 17), from 0 on.
const CLASSES: [([u8; 3], &str); 19] = [
    ([170, 170, 170], "never classified"),
    ([190, 190, 190], "unclassified"),
    ([160, 120, 80], "ground"),
    ([185, 215, 130], "low vegetation"),
    ([115, 180, 85], "medium vegetation"),
    ([45, 130, 60], "high vegetation"),
    ([215, 95, 75], "building"),
    ([230, 60, 160], "low noise"),
    ([205, 200, 150], "reserved"),
    ([75, 135, 215], "water"),
    ([125, 85, 145], "rail"),
    ([110, 110, 115], "road"),
    ([200, 160, 200], "overlap"),
    ([245, 200, 80], "wire, guard"),
    ([240, 170, 40], "wire, conductor"),
    ([90, 75, 160], "transmission tower"),
    ([225, 140, 60], "wire connector"),
    ([150, 165, 180], "bridge deck"),
    ([255, 90, 190], "high noise"),
];

/// A colour of the scale, 0 to 1.
pub fn scale_color(t: f32) -> [u8; 3] {
    let last = SCALE.len() - 1;
    let x = if t.is_finite() { t.clamp(0.0, 1.0) * last as f32 } else { last as f32 };
    let i = (x as usize).min(last - 1);
    let part = x - i as f32;
    std::array::from_fn(|c| {
        let (from, to) = (f32::from(SCALE[i][c]), f32::from(SCALE[i + 1][c]));
        // Rounding as `round` does, which calls a library for each number.
        (from + (to - from) * part + 0.5) as u8
    })
}

/// The colour of a class of points. Those that the specification does not name repeat the colours of those
/// that it does.
pub fn class_color(class: u8) -> [u8; 3] {
    CLASSES[usize::from(class) % CLASSES.len()].0
}

/// Name of a class in the specification, if it has one.
pub fn class_name(class: u8) -> Option<&'static str> {
    CLASSES.get(usize::from(class)).map(|(_, name)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_gets_darker_from_end_to_end() {
        let light = |t: f32| {
            scale_color(t).iter().zip([0.3, 0.59, 0.11]).map(|(c, w)| f64::from(*c) * w).sum::<f64>()
        };
        let lights: Vec<f64> = (0..=100).map(|i| light(i as f32 / 100.0)).collect();
        assert!(lights.windows(2).skip(20).all(|two| two[1] < two[0]), "{lights:?}");
        assert_eq!((scale_color(0.0), scale_color(1.0)), (SCALE[0], SCALE[5]));
        assert_eq!(
            (scale_color(7.0), scale_color(f32::NAN), scale_color(-1.0)),
            (SCALE[5], SCALE[5], SCALE[0])
        );
    }

    #[test]
    fn every_class_has_a_colour() {
        assert_eq!((class_color(2), class_name(2)), ([160, 120, 80], Some("ground")));
        assert_eq!((class_color(19), class_name(19)), (class_color(0), None));
        class_color(255);
    }
}
