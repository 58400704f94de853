//! Attributes of the samples: means over the vertices that are nearest, the same of any file, and each side
//! of a wall has its own.

use std::path::Path;

use glam::DVec3;
use simod_core::attributes::SampleAttributes;
use simod_core::sampled_model::SampledModel;
use simod_core::sampling::{Sampling, Target, sample};
use simod_model::Type;
use simod_model::output::write_file;
use simod_model::progress::Silent;

/// Vertices with numbers of several types, as files hold them.
struct Painted {
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
    red: Vec<u8>,
    level: Vec<i16>,
    quality: Vec<f32>,
    huge: Vec<f64>,
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Coding {
    Ascii,
    Little,
    Big,
}

impl Painted {
    /// A wavy sheet over the unit square, whose quality is known at one half alone.
    fn sheet() -> Self {
        let grid = (0..80 * 80).map(|i| DVec3::new(f64::from(i % 80), f64::from(i / 80), 0.0) / 79.0);
        let positions: Vec<DVec3> =
            grid.map(|p| (p + DVec3::Z * 0.05 * (5.0 * p.x).sin()).as_vec3().as_dvec3()).collect();
        let normals =
            positions.iter().map(|p| DVec3::new(-0.25 * (5.0 * p.x).cos(), 0.0, 1.0).normalize_or(DVec3::Z));
        let quality = |p: &DVec3| if p.x < 0.5 { p.y as f32 } else { f32::NAN };
        Self {
            normals: normals.map(|n| n.as_vec3().as_dvec3()).collect(),
            red: (0..positions.len()).map(|i| (i * 37 % 256) as u8).collect(),
            level: (0..positions.len()).map(|i| (i % 1000) as i16 - 500).collect(),
            quality: positions.iter().map(quality).collect(),
            huge: (0..positions.len()).map(|i| if i % 2 == 0 { 1e300 } else { 1.0 / 3.0 }).collect(),
            positions,
        }
    }

    /// As a file, perhaps with a list in each vertex.
    fn bytes(&self, coding: Coding, list: bool) -> Vec<u8> {
        let format = match coding {
            Coding::Ascii => "ascii",
            Coding::Little => "binary_little_endian",
            Coding::Big => "binary_big_endian",
        };
        let list_line = if list { "property list uchar short marks\n" } else { "" };
        let mut bytes = format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty uchar red\nproperty float x\nproperty float y\n\
             property float z\n{list_line}property short level\nproperty float nx\nproperty float ny\n\
             property float nz\nproperty float quality\nproperty double huge\nproperty float nothing\n\
             property uchar red\nend_header\n",
            self.positions.len()
        )
        .into_bytes();
        for i in 0..self.positions.len() {
            let (p, n) = (self.positions[i].as_vec3(), self.normals[i].as_vec3());
            let marks: Vec<i16> = (0..i % 4).map(|mark| mark as i16).collect();
            if coding == Coding::Ascii {
                let marks: Vec<String> = marks.iter().map(i16::to_string).collect();
                let marks = if list { format!("{} {}", marks.len(), marks.join(" ")) } else { String::new() };
                let (red, level, quality, huge) = (self.red[i], self.level[i], self.quality[i], self.huge[i]);
                let line = format!(
                    "{red} {} {} {} {marks} {level} {} {} {} {quality} {huge:e} nan 7\n",
                    p.x, p.y, p.z, n.x, n.y, n.z
                );
                bytes.extend(line.bytes());
                continue;
            }
            let mut put = |mut number: Vec<u8>| {
                if coding == Coding::Big {
                    number.reverse();
                }
                bytes.extend(number);
            };
            put(vec![self.red[i]]);
            p.to_array().into_iter().for_each(|x| put(x.to_le_bytes().into()));
            if list {
                put(vec![marks.len() as u8]);
                marks.iter().for_each(|mark| put(mark.to_le_bytes().into()));
            }
            put(self.level[i].to_le_bytes().into());
            n.to_array().into_iter().for_each(|x| put(x.to_le_bytes().into()));
            put(self.quality[i].to_le_bytes().into());
            put(self.huge[i].to_le_bytes().into());
            put(f32::NAN.to_le_bytes().into());
            put(vec![7]);
        }
        bytes
    }

    fn sampled(
        &self,
        path: &Path,
        coding: Coding,
        list: bool,
        samples: u64,
    ) -> (SampledModel, SampleAttributes) {
        write_file(path, &self.bytes(coding, list)).unwrap();
        let model = simod_model::open(path).unwrap();
        let how = Sampling { target: Target::Samples(samples), ..Sampling::default() };
        let sampled = sample(model.as_ref(), &how, path.parent().unwrap(), &Silent).unwrap();
        let attributes = sampled.stream_attributes(model.as_ref(), &Silent).unwrap();
        (sampled, attributes)
    }
}

/// The mean over the vertices that are nearest to each sample, as far as there is one.
fn means(sampled: &SampledModel, positions: &[DVec3], value: impl Fn(usize) -> f64) -> Vec<Option<f64>> {
    let samples = &sampled.samples.positions;
    let mut all = vec![(0.0, 0.0); samples.len()];
    for (i, p) in positions.iter().enumerate().filter(|(i, _)| value(*i).is_finite()) {
        let p = sampled.frame.to_local(*p);
        let distance = |s: &usize| samples[*s].distance_squared(p);
        let nearest = (0..samples.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        all[nearest].0 += value(i);
        all[nearest].1 += 1.0;
    }
    all.into_iter().map(|(sum, count)| (count > 0.0).then(|| sum / count)).collect()
}

#[test]
fn values_are_means_over_the_nearest_vertices_in_any_file() {
    let folder = tempfile::tempdir().unwrap();
    let painted = Painted::sheet();
    let mut known: Option<SampleAttributes> = None;
    for coding in [Coding::Little, Coding::Big, Coding::Ascii] {
        for list in [false, true] {
            let (sampled, attributes) = painted.sampled(&folder.path().join("m.ply"), coding, list, 150);
            assert!(
                *known.get_or_insert_with(|| attributes.clone()) == attributes,
                "{coding:?}, list: {list}"
            );
            let found: Vec<_> =
                attributes.all().iter().map(|of| (&*of.attribute.name, of.attribute.kind)).collect();
            // The second `red` is another one's name, and `nothing` has no number.
            let expected =
                [("red", Type::U8), ("level", Type::I16), ("quality", Type::F32), ("huge", Type::F64)];
            assert_eq!(found, expected);
            let close = |name: &str, expected: Vec<Option<f64>>| {
                let values = attributes.get(name).unwrap();
                assert_eq!(values.len(), expected.len());
                for (value, expected) in values.iter().zip(expected) {
                    let Some(expected) = expected else { continue };
                    assert!((f64::from(*value) - expected).abs() <= 1e-6 * expected.abs(), "{name}: {value}");
                }
            };
            let means = |value: &dyn Fn(usize) -> f64| means(&sampled, &painted.positions, value);
            close("red", means(&|i| f64::from(painted.red[i])));
            close("level", means(&|i| f64::from(painted.level[i])));
            // A number that is too large becomes the largest that samples can have.
            close("huge", means(&|i| painted.huge[i].min(f64::from(f32::MAX))));
            let quality = means(&|i| f64::from(painted.quality[i]));
            close("quality", quality.clone());
            // A sample without a value gets that of the nearest sample that has one.
            let samples = &sampled.samples.positions;
            let far = (0..samples.len()).filter(|i| quality[*i].is_none());
            let mut count = 0;
            for i in far {
                let nearest = (0..samples.len()).filter(|j| quality[*j].is_some());
                let distance = |j: &usize| samples[*j].distance_squared(samples[i]);
                let nearest = nearest.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
                let values = attributes.get("quality").unwrap();
                assert_eq!(values[i], values[nearest]);
                count += 1;
            }
            assert!(count > 50, "{count} samples without a vertex of known quality");
        }
    }
}

#[test]
fn a_thin_wall_keeps_the_colours_of_its_sides() {
    let folder = tempfile::tempdir().unwrap();
    let mut wall = Painted::sheet();
    let below = wall.positions.clone();
    let count = below.len();
    // Samples are some 0.08 apart, and the sides 0.01.
    wall.positions.extend(below.iter().map(|p| *p - DVec3::Z * 0.01));
    let back: Vec<DVec3> = wall.normals.iter().map(|n| -*n).collect();
    wall.normals.extend(back);
    wall.red = (0..2 * count).map(|i| if i < count { 255 } else { 0 }).collect();
    wall.level = vec![0; 2 * count];
    wall.quality = vec![0.0; 2 * count];
    wall.huge = vec![0.0; 2 * count];
    let (_, attributes) = wall.sampled(&folder.path().join("m.ply"), Coding::Little, false, 300);
    let red = attributes.get("red").unwrap();
    assert!(red.iter().all(|x| *x == 0.0 || *x == 255.0), "{red:?}");
    let above = red.iter().filter(|x| **x == 255.0).count();
    assert!(above * 3 > red.len() && above * 3 < 2 * red.len(), "{above} of {}", red.len());
}

#[test]
fn a_word_that_is_no_number_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    let painted = Painted::sheet();
    let (sampled, _) = painted.sampled(&path, Coding::Ascii, true, 150);
    let text = String::from_utf8(painted.bytes(Coding::Ascii, true)).unwrap();
    let place = text.find("end_header\n").unwrap() + 11;
    let (header, data) = text.split_at(place);
    // The same number of bytes, and the same vertices.
    let nth = data.match_indices('\n').nth(4).unwrap().0 + 1;
    let (before, after) = data.split_at(nth);
    let after = format!("x{}", &after[1..]);
    write_file(&path, format!("{header}{before}{after}").as_bytes()).unwrap();
    let model = simod_model::open(&path).unwrap();
    let error = sampled.stream_attributes(model.as_ref(), &Silent).unwrap_err().to_string();
    assert!(error.contains("vertex 5: \"red\" \"x"), "{error}");
}
