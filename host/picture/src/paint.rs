//! The vertices' own colours, and other numbers of theirs as colours.

use simod_core::colors::ColorBytes;
use simod_model::{Attribute, ColorScale, Colors, Error, Model, Progress, Result, Vertices, for_vertices};

use super::Image;
use super::palette::{class_color, scale_color};

/// The colour of a vertex: of its number in these parts of models that are read in step.
pub type PaintBy<'a> = dyn Fn(&[Vertices<'_>], usize) -> [u8; 3] + 'a;

/// Number of the first attributes that the painting of vertices needs, and the painting; none for plain clay.
pub(super) type Painted<'a> = Option<(usize, &'a PaintBy<'a>)>;

/// Source of the points' colours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Coloring {
    /// No source: all points look alike.
    Clay,
    /// The vertices' own colours.
    Own(Colors),
    /// The attribute at a place.
    Attribute(usize, Attribute),
}

/// Colours of points, by their numbers.
#[derive(Debug, Clone, PartialEq)]
pub enum Paint {
    /// All points look alike.
    Clay,
    /// The vertices' own colours, whose numbers mean this.
    Own(Colors, ColorScale),
    /// Classes, from the least to the largest that there are.
    Classes {
        /// The attribute's place.
        place: usize,
        /// The attribute's name.
        name: String,
        /// The numbers whose colours the legend shows.
        range: [f64; 2],
    },
    /// A scale from one number to another.
    Scale {
        /// The attribute's place.
        place: usize,
        /// The attribute's name.
        name: String,
        /// Numbers at the ends of the scale.
        range: [f64; 2],
    },
}

impl Coloring {
    /// Returns the colouring that the user names: `own`, `clay`, or an attribute by its name; without a name,
    /// the points' own colours if points with such attributes have any.
    ///
    /// # Errors
    /// The points have no colours of their own, or no such attribute.
    pub fn choose<'a>(
        word: Option<&str>,
        attributes: impl IntoIterator<Item = &'a Attribute>,
    ) -> Result<Self> {
        let attributes: Vec<&Attribute> = attributes.into_iter().collect();
        let own = Colors::seen(attributes.iter().copied());
        let by_name = |name: &str| attributes.iter().position(|attribute| attribute.name == name);
        match (word, own) {
            (Some("clay"), _) | (None, None) => Ok(Self::Clay),
            (Some("own") | None, Some(own)) => Ok(Self::Own(own)),
            (Some(name), _) => by_name(name)
                .map(|place| Self::Attribute(place, attributes[place].clone()))
                .ok_or_else(|| {
                    let what = match name {
                        "own" => "its vertices have no colours of their own".to_owned(),
                        _ => format!("its vertices have nothing that is called \"{name}\""),
                    };
                    let names: Vec<&str> =
                        attributes.iter().map(|attribute| attribute.name.as_str()).collect();
                    let hint = match &names[..] {
                        [] => "they have positions and normals alone: leave the colour out".to_owned(),
                        names => format!("they have {}", names.join(", ")),
                    };
                    Error::argument(what, hint)
                }),
        }
    }

    /// Places of the attributes whose numbers have to be known.
    fn places(&self) -> &[usize] {
        match self {
            Self::Clay => &[],
            Self::Own(colors) => &colors.places,
            Self::Attribute(place, _) => std::slice::from_ref(place),
        }
    }
}

impl Paint {
    /// Colours of a model's vertices. For an attribute, the model is read once more, which tells the scale.
    ///
    /// Memory: a chunk, and 512 KiB.
    ///
    /// # Errors
    /// The model cannot be read; the user cancelled.
    pub fn of_model(model: &dyn Model, coloring: Coloring, progress: &dyn Progress) -> Result<Self> {
        let mut numbers = NumberSurvey::default();
        match &coloring {
            Coloring::Clay => {}
            Coloring::Own(_) => {
                let meaning = ColorBytes::for_model(model)?.map(|bytes| bytes.meaning());
                return Ok(meaning.map_or(Self::Clay, |(colors, scale)| Self::Own(colors, scale)));
            }
            Coloring::Attribute(place, _) => {
                let mut values = vec![Vec::new(); place + 1];
                progress.begin("measuring", model.info().vertex_bytes);
                for_vertices(model, |chunk| {
                    progress.check()?;
                    model.attributes(chunk, &mut values)?;
                    values[*place].iter().for_each(|x| numbers.add(*x));
                    progress.advance(chunk.raw().len() as u64);
                    Ok(())
                })?;
            }
        }
        Ok(Self::new(coloring, &numbers))
    }

    /// Colours of points whose numbers are held: `values` has a list for each attribute.
    pub fn of_values(coloring: Coloring, values: &[&[f32]]) -> Self {
        let mut numbers = NumberSurvey::default();
        for place in coloring.places() {
            values[*place].iter().for_each(|x| numbers.add(f64::from(*x)));
        }
        Self::new(coloring, &numbers)
    }

    fn new(coloring: Coloring, numbers: &NumberSurvey) -> Self {
        match coloring {
            Coloring::Clay => Self::Clay,
            Coloring::Own(colors) => Self::Own(colors, ColorScale::for_largest(&colors, numbers.most)),
            Coloring::Attribute(place, of) if of.is_of_classes() => {
                Self::Classes { place, name: of.name, range: numbers.extremes() }
            }
            Coloring::Attribute(place, of) => {
                Self::Scale { place, name: of.name, range: numbers.most_of_them() }
            }
        }
    }

    /// Whether points are coloured, instead of looking all alike.
    pub fn is_colored(&self) -> bool {
        *self != Self::Clay
    }

    /// Number of the first attributes that [`color`](Self::color) asks for.
    pub fn count(&self) -> usize {
        match self {
            Self::Clay => 0,
            Self::Own(colors, _) => colors.count(),
            Self::Classes { place, .. } | Self::Scale { place, .. } => place + 1,
        }
    }

    /// Colour of a point, 8-bit sRGB, by its attribute at each place; attributes do not matter where all
    /// points are alike.
    #[inline]
    pub fn color(&self, attribute: impl Fn(usize) -> f64) -> [u8; 3] {
        match self {
            Self::Clay => [0; 3],
            Self::Own(colors, scale) => colors.places.map(|place| scale.byte(attribute(place))),
            Self::Classes { place, .. } => class_color(attribute(*place) as u8),
            Self::Scale { place, range, .. } => scale_color(part(*range, attribute(*place))),
        }
    }

    /// Name of the attribute whose numbers are shown, and the numbers at the ends of the legend.
    pub fn legend(&self) -> Option<(&str, [f64; 2])> {
        match self {
            Self::Clay | Self::Own(..) => None,
            Self::Classes { name, range, .. } | Self::Scale { name, range, .. } => Some((name, *range)),
        }
    }

    /// Returns a picture with a legend of its colours below it.
    pub fn with_legend(&self, image: &Image) -> Image {
        let Some((name, [from, to])) = self.legend() else { return image.clone() };
        let color = |t: f32| match self {
            Self::Classes { .. } => class_color((from + (to - from + 1.0) * f64::from(t)).min(to) as u8),
            _ => scale_color(t),
        };
        let labels = [short(from), format!("{} {}", name.to_uppercase(), short(to))];
        image.with_scale(color, [&labels[0], &labels[1]])
    }
}

/// Part of the way from one number to another at which a number lies, 0 to 1.
fn part([from, to]: [f64; 2], x: f64) -> f32 {
    if to > from { ((x - from) / (to - from)) as f32 } else { 0.0 }
}

/// Text of a number: whole numbers, which double precision holds, as they are; others with four digits at
/// most.
fn short(x: f64) -> String {
    if x.fract() == 0.0 && x.abs() < 1e15 {
        return format!("{x}");
    }
    let rounded: f64 = format!("{x:.3e}").parse().unwrap_or(x);
    if x == 0.0 || (1e-3..1e6).contains(&x.abs()) { format!("{rounded}") } else { format!("{rounded:e}") }
}

/// A survey of many numbers: their extremes, and by some of them, evenly spread, the range of most.
struct NumberSurvey {
    least: f64,
    most: f64,
    some: Vec<f64>,
    /// Step of the survey: one of so many numbers is kept.
    stride: u64,
    count: u64,
}

impl Default for NumberSurvey {
    fn default() -> Self {
        Self { least: f64::INFINITY, most: f64::NEG_INFINITY, some: Vec::new(), stride: 1, count: 0 }
    }
}

impl NumberSurvey {
    /// The most numbers that are held.
    const SOME: usize = 1 << 16;

    fn add(&mut self, x: f64) {
        if !x.is_finite() {
            return;
        }
        (self.least, self.most) = (self.least.min(x), self.most.max(x));
        if self.count.is_multiple_of(self.stride) {
            if self.some.len() == Self::SOME {
                let mut kept = false;
                self.some.retain(|_| {
                    kept = !kept;
                    kept
                });
                self.stride *= 2;
            }
            if self.count.is_multiple_of(self.stride) {
                self.some.push(x);
            }
        }
        self.count += 1;
    }

    fn extremes(&self) -> [f64; 2] {
        if self.count > 0 { [self.least, self.most] } else { [0.0, 1.0] }
    }

    /// The range of all but a few: a hundredth of them at either end.
    fn most_of_them(&self) -> [f64; 2] {
        let mut sorted = self.some.clone();
        sorted.sort_by(f64::total_cmp);
        let Some(last) = sorted.len().checked_sub(1) else { return [0.0, 1.0] };
        let few = sorted.len() / 100;
        let [from, to] = [sorted[few], sorted[last - few]];
        if from < to { [from, to] } else { self.extremes() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use simod_model::Type;

    #[test]
    fn most_numbers_are_found_among_very_many() {
        let mut numbers = NumberSurvey::default();
        (0..1_000_000u32).for_each(|i| numbers.add(f64::from(i)));
        [1e30, -1e30, f64::NAN].into_iter().for_each(|x| numbers.add(x));
        let [from, to] = numbers.most_of_them();
        assert!((from - 1e4).abs() < 100.0 && (to - 9.9e5).abs() < 100.0, "{from} {to}");
        assert_eq!(numbers.extremes(), [-1e30, 1e30]);
        assert!(numbers.some.len() <= NumberSurvey::SOME);
        assert_eq!(NumberSurvey::default().most_of_them(), [0.0, 1.0]);
    }

    #[test]
    fn what_is_said_is_chosen() {
        let of = |name: &str| Attribute { name: name.to_owned(), kind: Type::U16 };
        let all = ["intensity", "red", "green", "blue"].map(of);
        let own = Colors { places: [1, 2, 3], kind: Type::U16, of_splats: false };
        assert_eq!(Coloring::choose(None, &all).unwrap(), Coloring::Own(own));
        assert_eq!(Coloring::choose(Some("own"), &all).unwrap(), Coloring::Own(own));
        assert_eq!(Coloring::choose(Some("clay"), &all).unwrap(), Coloring::Clay);
        let intensity = Coloring::Attribute(0, all[0].clone());
        assert_eq!(Coloring::choose(Some("intensity"), &all).unwrap(), intensity);
        assert_eq!(Coloring::choose(None, &all[..1]).unwrap(), Coloring::Clay);
        let error = |word, attributes: &[Attribute]| Coloring::choose(Some(word), attributes).unwrap_err();
        assert!(error("own", &all[..1]).to_string().contains("no colours of their own"));
        assert!(error("gps", &all).to_string().contains("\"gps\""));
    }

    #[test]
    fn whole_numbers_of_a_legend_are_as_they_are() {
        let told = [65535.0, -123_456.0, 4_294_967_295.0, 0.0, 0.123_456, 1234.56, 12345.6, 1e-7, 3e20];
        let shown = ["65535", "-123456", "4294967295", "0", "0.1235", "1235", "12350", "1e-7", "3e20"];
        assert_eq!(told.map(short), shown);
    }

    #[test]
    fn numbers_become_colours() {
        let own = Coloring::Own(Colors { places: [0, 1, 2], kind: Type::U16, of_splats: false });
        let wide = Paint::of_values(own.clone(), &[&[0.0, 65535.0], &[0.0, 1.0], &[1.0, 2.0]]);
        assert_eq!(wide.color(|_| 65535.0), [255; 3]);
        let narrow = Paint::of_values(own, &[&[0.0, 255.0], &[0.0, 1.0], &[1.0, 2.0]]);
        assert_eq!(narrow.color(|place| 10.0 * place as f64), [0, 10, 20]);
        let of = |name: &str| Coloring::Attribute(0, Attribute { name: name.to_owned(), kind: Type::U8 });
        let scale = Paint::of_values(of("x"), &[&[2.0, 4.0]]);
        assert_eq!([scale.color(|_| 2.0), scale.color(|_| 4.0)], [scale_color(0.0), scale_color(1.0)]);
        let classes = Paint::of_values(of("classification"), &[&[2.0, 6.0]]);
        assert_eq!(classes.color(|_| 6.0), class_color(6));
        let image = Image::new(200, 10, [255; 3]);
        let legend = classes.with_legend(&image);
        for class in 2..=6 {
            assert!(legend.pixels().contains(&class_color(class)), "{class}");
        }
        assert_eq!(Paint::Clay.with_legend(&image).pixels(), image.pixels());
        // All numbers alike.
        let flat = Paint::of_values(of("x"), &[&[2.0]]);
        assert_eq!(flat.color(|_| 2.0), scale_color(0.0));
    }
}
