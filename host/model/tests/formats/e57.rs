//! Files are written here by hand, in packets of any shape, and by the crate `e57`; what becomes of them is
//! read by that crate.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Mutex;

use ::e57::{E57Reader, E57Writer, Record, RecordDataType, RecordName, RecordValue};
use glam::{DQuat, DVec3, Mat3, Vec3};
use proptest::prelude::*;
use simod_model::follow::{Follow, TensorKind};
use simod_model::{Output, Rewriting, Summary, progress::Silent};

use super::obj::Notes;
use super::*;

/// A file that bytes can be replaced in.
#[derive(Default)]
struct Target(Vec<u8>);

impl Output for Target {
    fn write_pieces(&mut self, _: u64, bytes: &[u8], _: u64, _: &Summary) -> std::io::Result<()> {
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn patch(&mut self, at: u64, bytes: &[u8]) -> std::io::Result<()> {
        self.0[at as usize..at as usize + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn finish(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Writes the model with these moves of positions, in two versions at a time.
fn move_points(model: &dyn Model, to: impl Fn(DVec3) -> DVec3 + Sync) -> Result<Vec<u8>> {
    let (mut first, mut second) = (Target::default(), Target::default());
    let edit = |_: &VertexChunk, versions: &mut [Edited]| {
        for version in versions {
            version.positions.iter_mut().filter(|p| p.is_finite()).for_each(|p| *p = to(*p));
        }
        Ok(())
    };
    model.rewrite(&mut [&mut first, &mut second], Rewriting::default(), &edit, &Silent)?;
    assert!(first.0 == second.0);
    Ok(first.0)
}

/// A field of a scan that is made here.
#[derive(Debug, Clone)]
struct Made {
    /// The field's element.
    xml: String,
    bits: u32,
    numbers: Vec<u64>,
}

impl Made {
    fn double(name: &str, numbers: impl IntoIterator<Item = f64>) -> Self {
        let xml = format!("<{name} type=\"Float\"/>");
        Self { xml, bits: 64, numbers: numbers.into_iter().map(f64::to_bits).collect() }
    }

    fn single(name: &str, numbers: impl IntoIterator<Item = f64>) -> Self {
        let xml = format!("<{name} type=\"Float\" precision=\"single\"/>");
        let numbers = numbers.into_iter().map(|n| u64::from((n as f32).to_bits())).collect();
        Self { xml, bits: 32, numbers }
    }

    /// Numbers of so many bits, from `min` on.
    fn scaled(
        name: &str,
        bits: u32,
        scale: f64,
        offset: f64,
        numbers: impl IntoIterator<Item = f64>,
    ) -> Self {
        let min = -(1i64 << bits >> 1);
        let max = min + ((1i64 << bits) - 1);
        let xml = format!(
            "<{name} type=\"ScaledInteger\" minimum=\"{min}\" maximum=\"{max}\" scale=\"{scale:?}\" offset=\"{offset:?}\"/>"
        );
        let number = |n: f64| ((((n - offset) / scale).round() as i64).clamp(min, max) - min) as u64;
        Self { xml, bits, numbers: numbers.into_iter().map(number).collect() }
    }

    fn integer(name: &str, bits: u32, numbers: impl IntoIterator<Item = u64>) -> Self {
        let max = (1u64 << bits) - 1;
        let xml = format!("<{name} type=\"Integer\" minimum=\"0\" maximum=\"{max}\"/>");
        Self { xml, bits, numbers: numbers.into_iter().map(|n| n & max).collect() }
    }

    fn stream(&self) -> Vec<u8> {
        let (mut bytes, mut at) = (vec![0u8; (self.numbers.len() * self.bits as usize).div_ceil(8)], 0);
        for number in &self.numbers {
            for bit in 0..self.bits {
                bytes[at / 8] |= ((number >> bit & 1) as u8) << (at % 8);
                at += 1;
            }
        }
        bytes
    }
}

#[derive(Debug, Clone, Default)]
struct MadeScan {
    fields: Vec<Made>,
    /// Elements before the points: pose, bounds.
    xml: String,
    /// Whether there are packets without points among the others, which the crate cannot read.
    has_others: bool,
}

/// Place of the XML in the file.
#[derive(Debug, Clone, Copy, PartialEq)]
enum At {
    End,
    /// The XML is before the points: its places are found by trying.
    Start,
    /// The XML is before other content at the end.
    BeforeEnd,
}

/// The file of some scans; `share` says how many bytes of a stream with so many left a packet gets.
fn make(scans: &[MadeScan], xml_at: At, mut share: impl FnMut(usize) -> usize) -> Vec<u8> {
    let sections: Vec<Vec<u8>> = scans.iter().map(|scan| packets(scan, &mut share)).collect();
    let physical = |at: usize| at / 1020 * 1024 + at % 1020;
    let build = |xml_len: usize| {
        let mut bytes = vec![0; 48];
        let mut xml_place = 0;
        if xml_at == At::Start {
            xml_place = bytes.len();
            bytes.resize(bytes.len() + xml_len, 0);
        }
        let mut places = Vec::new();
        for section in &sections {
            bytes.resize(bytes.len().next_multiple_of(4) + 8, b'#');
            let at = bytes.len();
            places.push(physical(at));
            let mut section = section.clone();
            section[16..24].copy_from_slice(&(physical(at + 32) as u64).to_le_bytes());
            bytes.extend(section);
        }
        bytes.extend_from_slice(b"something between");
        if xml_at != At::Start {
            bytes.resize(bytes.len().next_multiple_of(4), 0);
            xml_place = bytes.len();
            bytes.resize(bytes.len() + xml_len, 0);
        }
        if xml_at == At::BeforeEnd {
            bytes.extend(vec![b'~'; 3000]);
        }
        let mut xml = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<e57Root type=\"Structure\" \
             xmlns=\"http://www.astm.org/COMMIT/E57/2010-e57-v1.0\" xmlns:nor=\"http://www.libe57.org/E57_NOR_surface_normals.txt\">\n\
             <formatName type=\"String\"><![CDATA[ASTM E57 3D Imaging Data File]]></formatName>\n\
             <guid type=\"String\">{1}</guid><versionMajor type=\"Integer\">1</versionMajor>\
             <versionMinor type=\"Integer\"/>\n<coordinateMetadata type=\"String\"><![CDATA[PROJCS[\"Here\",X[]]]]></coordinateMetadata>\n\
             <data3D type=\"Vector\" allowHeterogeneousChildren=\"1\">\n"
            .to_owned();
        for (scan, place) in scans.iter().zip(&places) {
            let count = scan.fields[0].numbers.len();
            let prototype: String = scan.fields.iter().map(|f| f.xml.clone()).collect();
            xml += &format!(
                "<vectorChild type=\"Structure\"><guid type=\"String\">{{2}}</guid>{}\n<points type=\"CompressedVector\" \
                 fileOffset=\"{place}\" recordCount=\"{count}\"><prototype type=\"Structure\">{prototype}</prototype>\
                 <codecs type=\"Vector\" allowHeterogeneousChildren=\"1\"/></points></vectorChild>\n",
                scan.xml
            );
        }
        xml += "</data3D>\n<images2D type=\"Vector\" allowHeterogeneousChildren=\"1\"/>\n</e57Root>\n";
        (bytes, xml_place, xml)
    };
    let mut len = 0;
    loop {
        let (mut bytes, place, xml) = build(len);
        if xml.len() != len {
            len = xml.len();
            continue;
        }
        bytes[place..place + len].copy_from_slice(xml.as_bytes());
        let pages = bytes.len().div_ceil(1020);
        bytes.resize(pages * 1020, 0);
        bytes[..8].copy_from_slice(b"ASTM-E57");
        bytes[8..12].copy_from_slice(&1u32.to_le_bytes());
        bytes[16..24].copy_from_slice(&(1024 * pages as u64).to_le_bytes());
        bytes[24..32].copy_from_slice(&(physical(place) as u64).to_le_bytes());
        bytes[32..40].copy_from_slice(&(len as u64).to_le_bytes());
        bytes[40..48].copy_from_slice(&1024u64.to_le_bytes());
        return paged(&bytes);
    }
}

/// Puts checksums behind pages, slowly.
fn paged(logical: &[u8]) -> Vec<u8> {
    let crc = |page: &[u8]| {
        !page.iter().fold(!0u32, |crc, byte| {
            (0..8)
                .fold(crc ^ u32::from(*byte), |crc, _| crc >> 1 ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 })
        })
    };
    logical.chunks(1020).flat_map(|page| [page, &crc(page).to_be_bytes()].concat()).collect()
}

/// The bytes between the checksums.
fn unpaged(bytes: &[u8]) -> Vec<u8> {
    bytes.chunks(1024).flat_map(|page| page[..page.len().min(1020)].to_vec()).collect()
}

fn packets(scan: &MadeScan, share: &mut impl FnMut(usize) -> usize) -> Vec<u8> {
    let mut streams: Vec<Vec<u8>> = scan.fields.iter().map(Made::stream).collect();
    let mut section = vec![0; 32];
    section[0] = 1;
    let mut number = 0;
    while streams.iter().any(|stream| !stream.is_empty()) {
        let parts: Vec<Vec<u8>> = streams
            .iter_mut()
            .map(|stream| {
                let count = share(stream.len()).min(stream.len()).min(60_000 / scan.fields.len());
                stream.drain(..count).collect()
            })
            .collect();
        let mut packet = vec![1, 0, 0, 0];
        packet.extend((parts.len() as u16).to_le_bytes());
        parts.iter().for_each(|part| packet.extend((part.len() as u16).to_le_bytes()));
        parts.iter().for_each(|part| packet.extend(part));
        packet.resize(packet.len().next_multiple_of(4), 0);
        let length = packet.len() as u16 - 1;
        packet[2..4].copy_from_slice(&length.to_le_bytes());
        section.extend(packet);
        number += 1;
        if scan.has_others && number % 3 == 1 {
            // An ignored packet; and an index packet, of any content.
            section.extend([2, 0, 7, 0, 9, 9, 9, 9]);
            let mut index = vec![0; 32];
            index[2] = 31;
            section.extend(index);
        }
    }
    let length = section.len() as u64;
    section[8..16].copy_from_slice(&length.to_le_bytes());
    section
}

/// Points of all scans, as the crate reads them, in bits; and the scans as the crate knows them.
fn by_crate(bytes: &[u8]) -> (Vec<Vec<Vec<u64>>>, Vec<::e57::PointCloud>) {
    let clouds = E57Reader::new(Cursor::new(bytes)).unwrap().pointclouds();
    let bits = |(value, record): (&RecordValue, &Record)| match (value, &record.data_type) {
        (RecordValue::Single(v), _) => u64::from(v.to_bits()),
        (RecordValue::Double(v), _) => v.to_bits(),
        (
            RecordValue::Integer(v) | RecordValue::ScaledInteger(v),
            RecordDataType::Integer { min, .. } | RecordDataType::ScaledInteger { min, .. },
        ) => (v - min) as u64,
        _ => panic!("of another type"),
    };
    let scan = |cloud: &::e57::PointCloud, reader: &mut E57Reader<Cursor<&[u8]>>| {
        let points = reader.pointcloud_raw(cloud).unwrap();
        points.map(|point| point.unwrap().iter().zip(&cloud.prototype).map(bits).collect()).collect()
    };
    let mut reader = E57Reader::new(Cursor::new(bytes)).unwrap();
    (clouds.iter().map(|cloud| scan(cloud, &mut reader)).collect(), clouds)
}

fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}

const POSE: &str = "<pose type=\"Structure\"><rotation type=\"Structure\"><w type=\"Float\">0.8</w><x type=\"Float\"/>\
    <y type=\"Float\">0.36</y><z type=\"Float\">0.48</z></rotation><translation type=\"Structure\">\
    <x type=\"Float\">412345.5</x><y type=\"Float\">5318765.25</y><z type=\"Float\">100</z></translation></pose>";

fn pose() -> (DQuat, DVec3) {
    (DQuat::from_xyzw(0.0, 0.36, 0.48, 0.8), DVec3::new(412_345.5, 5_318_765.25, 100.0))
}

fn bounds(name: &str, numbers: [(&str, String); 6]) -> String {
    let inner: String = numbers.iter().map(|(n, v)| format!("<{n} type=\"Float\">{v}</{n}>")).collect();
    format!("<{name} type=\"Structure\">{inner}</{name}>")
}

fn cartesian_bounds(numbers: [&str; 6]) -> String {
    let names = ["xMinimum", "xMaximum", "yMinimum", "yMaximum", "zMinimum", "zMaximum"];
    let mut numbers = numbers.into_iter();
    bounds("cartesianBounds", names.map(|name| (name, numbers.next().unwrap().to_owned())))
}

/// Three scans: doubles with a pose and normals; scaled integers of odd widths with invalid points; spherical
/// ones.
fn three(count: usize) -> Vec<MadeScan> {
    let mut next = random(count as u64);
    let mut list = |scale: f64| -> Vec<f64> { (0..count).map(|_| scale * (next() - 0.5)).collect() };
    let first = MadeScan {
        fields: vec![
            Made::double("cartesianX", list(20.0)),
            Made::double("cartesianY", list(20.0)),
            Made::double("cartesianZ", list(4.0)),
            Made::integer("colorRed", 8, (0..count as u64).map(|i| i * 7)),
            Made::integer("colorGreen", 8, (0..count as u64).map(|i| i * 5)),
            Made::integer("colorBlue", 8, (0..count as u64).map(|i| i * 3)),
            Made::integer("isColorInvalid", 1, (0..count as u64).map(|i| i / 3)),
            Made::single("intensity", list(1.0)),
        ],
        xml: POSE.to_owned() + &cartesian_bounds(["-10", "10.0000", "-10.000", "10", "-2", "2"]),
        ..MadeScan::default()
    };
    let second = MadeScan {
        fields: vec![
            Made::integer("rowIndex", 11, (0..count as u64).map(|i| i % 40)),
            Made::scaled("cartesianX", 19, 0.001, 5.0, list(60.0)),
            Made::scaled("cartesianY", 17, 0.001, 0.0, list(60.0)),
            Made::scaled("cartesianZ", 29, 1e-6, -3.0, list(60.0)),
            Made::integer(
                "cartesianInvalidState",
                2,
                (0..count as u64).map(|i| if i % 9 == 4 { 1 + i % 2 } else { 0 }),
            ),
        ],
        xml: cartesian_bounds(["-1e6", "1e6", "-1e6", "1e6", "-1e6", "1e6"]).replace(">1e6</xMaximum>", "/>"),
        ..MadeScan::default()
    };
    let third = MadeScan {
        fields: vec![
            Made::single("sphericalRange", list(3.0).into_iter().map(|r| 5.0 + r)),
            Made::single("sphericalAzimuth", list(6.2)),
            Made::double("sphericalElevation", list(3.0)),
            Made::integer(
                "sphericalInvalidState",
                2,
                (0..count as u64).map(|i| if i % 13 == 0 { 2 } else { 0 }),
            ),
            Made::double("timeStamp", list(9.0)),
        ],
        xml: POSE.to_owned(),
        ..MadeScan::default()
    };
    vec![first, second, third]
}

/// The positions that the crate's numbers mean.
fn positions(scans: &[MadeScan], read: &[Vec<Vec<u64>>]) -> Vec<DVec3> {
    let mut all = Vec::new();
    for (number, (scan, points)) in scans.iter().zip(read).enumerate() {
        let value = |field: usize, bits: u64| match scan.fields[field].bits {
            32 => f64::from(f32::from_bits(bits as u32)),
            64 => f64::from_bits(bits),
            bits_of => {
                let xml = &scan.fields[field].xml;
                let attribute = |name: &str| {
                    let (_, rest) = xml.split_once(&format!("{name}=\"")).unwrap();
                    rest.split_once('"').unwrap().0.parse::<f64>().unwrap()
                };
                (bits as f64 - (1u64 << (bits_of - 1)) as f64) * attribute("scale") + attribute("offset")
            }
        };
        for point in points {
            let three = |at: usize| [0, 1, 2].map(|i| value(at + i, point[at + i]));
            let local = match number {
                0 => DVec3::from(three(0)),
                1 if point[4] == 0 => DVec3::from(three(1)),
                2 if point[3] == 0 => {
                    let [r, a, e] = three(0);
                    DVec3::new(r * e.cos() * a.cos(), r * e.cos() * a.sin(), r * e.sin())
                }
                _ => DVec3::NAN,
            };
            let (rotation, translation) = pose();
            all.push(if number == 1 { local } else { rotation * local + translation });
        }
    }
    all
}

fn check_near(found: &[DVec3], expected: &[DVec3], bounds: impl Fn(usize) -> f64) {
    assert_eq!(found.len(), expected.len());
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!(
            found.is_nan() && expected.is_nan() || (*found - *expected).length() <= bounds(i),
            "{i}: {found} for {expected}"
        );
    }
}

fn shear(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1 * p.z, 0.0, 0.01 * p.x.sin())
}

#[test]
fn points_of_all_scans_are_where_the_crate_has_them() {
    for (count, xml_at) in [(1, At::End), (70, At::End), (3000, At::Start), (3001, At::BeforeEnd)] {
        let scans = three(count);
        let mut next = random(1);
        let bytes = make(&scans, xml_at, |left| (next() * 900.0) as usize % (left + 7));
        let model = check_whole(&bytes, ".e57");
        let (read_by_crate, _) = by_crate(&bytes);
        for (scan, points) in scans.iter().zip(&read_by_crate) {
            for (i, field) in scan.fields.iter().enumerate() {
                assert!(points.iter().map(|p| p[i]).eq(field.numbers.iter().copied()));
            }
        }
        let (found, _) = read(model.as_ref()).unwrap();
        check_near(&found, &positions(&scans, &read_by_crate), |_| 1e-8);
        let info = model.info();
        assert_eq!(
            (&*info.format, info.vertices, info.crs.as_deref()),
            ("E57 1.0, 3 scans", 3 * count as u64, Some("Here"))
        );
        let names: Vec<String> = info.attributes.iter().map(|a| a.name.clone()).collect();
        assert_eq!(
            names.join(" "),
            "red green blue isColorInvalid intensity rowIndex cartesianInvalidState sphericalInvalidState timeStamp"
        );
        assert_eq!(model.details().len(), 3);
        assert!(
            model.details()[0].contains("412345.5") && model.details()[1].contains("cartesianY in 17 bits")
        );
    }
}

#[test]
fn attributes_are_the_numbers_of_their_scan() {
    let scans = three(500);
    let model = open(&make(&scans, At::End, |left| left / 3 + 1), ".e57").unwrap();
    let mut reader = model.vertices(400..1100).unwrap();
    let mut chunk = VertexChunk::default();
    let mut lists = vec![Vec::new(); 9];
    let mut sizes = Vec::new();
    while reader.read(&mut chunk).unwrap() {
        model.attributes(&chunk, &mut lists).unwrap();
        assert!(lists.iter().all(|list| list.len() == chunk.len()));
        sizes.push(chunk.len());
        if chunk.first == 400 {
            let expected = (400..500).map(|i| scans[0].fields[3].numbers[i] as f64);
            assert!(lists[0].iter().copied().eq(expected) && lists[8].iter().all(|v| v.is_nan()));
        }
        if chunk.first == 1000 {
            assert_eq!(lists[8][7], f64::from_bits(scans[2].fields[4].numbers[7]));
        }
    }
    assert_eq!(sizes, [100, 500, 100]);
}

#[test]
fn what_moves_moves_and_all_else_stays() {
    for (count, xml_at) in
        [(1, At::End), (90, At::End), (4000, At::End), (4000, At::Start), (4000, At::BeforeEnd)]
    {
        let scans = three(count);
        let mut next = random(2);
        let bytes = make(&scans, xml_at, |left| (next() * 700.0) as usize % (left + 7));
        let model = open(&bytes, ".e57").unwrap();
        let out = move_points(model.as_ref(), shear).unwrap();
        let (before, _) = by_crate(&bytes);
        let (after, clouds) = by_crate(&out);
        for (number, moving) in [(0, 0..3), (1, 1..4), (2, 0..3)] {
            for (old, new) in before[number].iter().zip(&after[number]) {
                let is_invalid = matches!(number, 1 if old[4] != 0) || matches!(number, 2 if old[3] != 0);
                for field in 0..old.len() {
                    if is_invalid || !moving.contains(&field) {
                        assert_eq!(old[field], new[field]);
                    }
                }
            }
        }
        let old = positions(&scans, &before);
        let expected: Vec<DVec3> = old.iter().map(|p| if p.is_finite() { shear(*p) } else { *p }).collect();
        let bound = |i: usize| [1e-8, 0.001, 4e-6][i / count];
        check_near(&positions(&scans, &after), &expected, bound);
        // The written file can be read again, and its points moved back.
        let again = open(&out, ".e57").unwrap();
        check_near(&read(again.as_ref()).unwrap().0, &expected, bound);
        check_bounds(&after, &clouds);
    }
}

/// Bounds are those of the points now.
fn check_bounds(points: &[Vec<Vec<u64>>], clouds: &[::e57::PointCloud]) {
    for (number, first) in [(0, 0), (1, 1)] {
        let told = clouds[number].cartesian_bounds.as_ref().unwrap();
        let told = [(told.x_min, told.x_max), (told.y_min, told.y_max), (told.z_min, told.z_max)];
        let local: Vec<[f64; 3]> = points[number]
            .iter()
            .filter(|p| number == 0 || p[4] == 0)
            .map(|p| {
                [0, 1, 2].map(|axis| match &clouds[number].prototype[first + axis].data_type {
                    RecordDataType::Double { .. } => f64::from_bits(p[first + axis]),
                    RecordDataType::ScaledInteger { min, scale, offset, .. } => {
                        (p[first + axis] as i64 + min) as f64 * scale + offset
                    }
                    _ => panic!("another type"),
                })
            })
            .collect();
        for (axis, (min, max)) in told.into_iter().enumerate() {
            let of = |f: fn(f64, f64) -> f64| local.iter().map(|p| p[axis]).reduce(f).unwrap();
            assert!(min.unwrap() <= of(f64::min) && max.unwrap_or(0.0) >= of(f64::max), "{number} {axis}");
        }
    }
}

#[test]
fn bounds_follow_where_they_change_and_keep_their_text_elsewhere() {
    let up = |p: DVec3| if p.x > 1.5 { p + DVec3::new(0.0, 0.0, 1.0 / 3.0) } else { p };
    let x = [0.0, 1.0, 2.0];
    let scan = |text: &str| MadeScan {
        fields: vec![
            Made::double("cartesianX", x),
            Made::double("cartesianY", x),
            Made {
                xml: "<cartesianZ type=\"Float\" minimum=\"0\" maximum=\"2\"/>".into(),
                ..Made::double("cartesianZ", x)
            },
        ],
        xml: cartesian_bounds(["0", "2.00", "0e0", "2", "0", text]),
        ..MadeScan::default()
    };
    for (at, text) in [
        (At::End, "2"),
        (At::End, "2.000000000000000000"),
        (At::Start, "2"),
        (At::Start, "2.000000000000000000"),
    ] {
        let bytes = make(&[scan(text)], at, |left| left);
        let out = move_points(open(&bytes, ".e57").unwrap().as_ref(), up).unwrap();
        let (_, clouds) = by_crate(&out);
        let told = clouds[0].cartesian_bounds.clone().unwrap();
        assert_eq!((told.x_max, told.z_min, told.z_max), (Some(2.0), Some(0.0), Some(2.0 + 1.0 / 3.0)));
        let text = String::from_utf8_lossy(&unpaged(&out)).into_owned();
        for kept in [">2.00</xMaximum>", ">0e0</yMinimum>", "minimum=\"0\" maximum=\"2.33333"] {
            assert!(text.contains(kept), "{kept}");
        }
        assert!(
            matches!(clouds[0].prototype[2].data_type, RecordDataType::Double { max: Some(m), .. } if m > 2.3)
        );
        open(&out, ".e57").unwrap();
    }
}

#[test]
fn azimuths_that_go_round_become_all_around() {
    let degrees = |list: [f64; 3]| list.map(f64::to_radians);
    let names = [
        "rangeMinimum",
        "rangeMaximum",
        "elevationMinimum",
        "elevationMaximum",
        "azimuthStart",
        "azimuthEnd",
    ];
    let told = ["1", "1", "0", "0", "2.96705972839036", "-2.96705972839036"];
    let mut told = told.into_iter();
    let scan = MadeScan {
        fields: vec![
            Made::double("sphericalRange", [1.0; 3]),
            Made::double("sphericalAzimuth", degrees([170.0, 180.0, -170.0])),
            Made::double("sphericalElevation", [0.0; 3]),
        ],
        xml: bounds("sphericalBounds", names.map(|name| (name, told.next().unwrap().to_owned()))),
        ..MadeScan::default()
    };
    let bytes = make(&[scan], At::End, |left| left);
    let turn = |angle: f64| move |p: DVec3| DQuat::from_rotation_z(angle) * p;
    let out = move_points(open(&bytes, ".e57").unwrap().as_ref(), turn(0.2)).unwrap();
    let bounds = by_crate(&out).1[0].spherical_bounds.clone().unwrap();
    assert_eq!(bounds.azimuth_start, Some(-std::f64::consts::PI));
    assert_eq!(bounds.azimuth_end, Some(std::f64::consts::PI));
    assert!(bounds.range_max.unwrap() >= 1.0 - 1e-12);
}

#[test]
fn packets_without_points_are_passed_over_and_kept() {
    let scans = three(5000);
    let with_others: Vec<MadeScan> =
        scans.iter().map(|scan| MadeScan { has_others: true, ..scan.clone() }).collect();
    let [plain, other] = [&scans, &with_others].map(|scans| make(scans, At::End, |left| left / 7 + 1));
    let [plain, model] = [(&plain, check_whole(&plain, ".e57")), (&other, check_whole(&other, ".e57"))];
    assert!(model.0.len() > plain.0.len());
    let moved = [&plain, &model].map(|(_, model)| move_points(model.as_ref(), shear).unwrap());
    let read = moved.map(|bytes| read(open(&bytes, ".e57").unwrap().as_ref()).unwrap().0);
    assert_eq!(format!("{:?}", read[0]), format!("{:?}", read[1]));
}

#[test]
fn what_does_not_fit_the_bits_is_an_error_that_says_so() {
    let scan = MadeScan {
        fields: ["cartesianX", "cartesianY", "cartesianZ"]
            .map(|n| Made::scaled(n, 10, 0.01, 0.0, [1.0, 2.0]))
            .to_vec(),
        ..MadeScan::default()
    };
    let free = MadeScan {
        fields: ["cartesianX", "cartesianY", "cartesianZ"].map(|n| Made::single(n, [0.0])).to_vec(),
        ..MadeScan::default()
    };
    let both = open(&make(&[scan.clone(), free], At::End, |left| left), ".e57").unwrap();
    let model = open(&make(&[scan], At::End, |left| left), ".e57").unwrap();
    // Told of a position alone where no scan has room for it.
    for (y, has_room) in [(5.0, true), (-5.11, true), (5.2, false), (-6.0, false)] {
        assert_eq!(model.has_room_for(DVec3::new(1.0, y, 2.0)), has_room, "{y}");
        assert!(both.has_room_for(DVec3::new(1.0, y, 2.0)));
    }
    let error = message(move_points(model.as_ref(), |p| p + DVec3::Y * 3.2));
    assert_eq!(error, "vertex 1 moves to cartesianY = 5.2 of scan 1, which has room for -5.12 to 5.11 alone");
    assert!(move_points(model.as_ref(), |p| p + DVec3::Y * 3.0).is_ok());
    let error = message(move_points(model.as_ref(), |_| DVec3::new(0.0, f64::NAN, 0.0)));
    assert_eq!(error, "the deformation moves vertex 0 to NaN");
}

/// New position of each point.
type Motion = Box<dyn Fn(DVec3) -> DVec3 + Sync>;

#[test]
fn angles_get_other_ranges_where_their_bits_allow() {
    let mut next = random(5);
    let mut list =
        |least: f64, most: f64| (0..500).map(|_| least + (most - least) * next()).collect::<Vec<_>>();
    let scan = MadeScan {
        fields: vec![
            Made::scaled("sphericalRange", 14, 0.001, 8.0, list(5.0, 9.0)),
            Made::scaled("sphericalAzimuth", 10, 0.001, 0.3, list(0.1, 0.6)),
            Made::scaled("sphericalElevation", 10, 0.001, 0.2, list(0.0, 0.4)),
        ],
        xml: POSE.to_owned(),
        ..MadeScan::default()
    };
    let bytes = make(&[scan], At::End, |left| left / 2 + 1);
    let (rotation, place) = pose();
    let about = |turn: DQuat| move |p: DVec3| place + rotation * (turn * (rotation.inverse() * (p - place)));
    let turns = |angle: f64| about(DQuat::from_rotation_z(angle));
    let cases: [(&str, Motion); 6] = [
        ("sphericalAzimuth", Box::new(turns(1.0))),
        ("sphericalAzimuth", Box::new(turns(-0.6))),
        // Through half a turn, from where some count on and others from below.
        ("sphericalAzimuth", Box::new(turns(2.79))),
        ("sphericalAzimuth", Box::new(turns(-3.5))),
        ("sphericalElevation", Box::new(about(DQuat::from_rotation_y(-0.8)))),
        ("sphericalRange", Box::new(move |p| place + 2.0 * (p - place))),
    ];
    for (field, motion) in cases {
        let mut model = open(&bytes, ".e57").unwrap();
        let before = read(model.as_ref()).unwrap().0;
        assert!(message(move_points(model.as_ref(), &motion)).contains(field));
        let moves: Vec<[DVec3; 2]> = before.iter().map(|p| [*p, motion(*p)]).collect();
        let changed = model.make_room(&moves, 0.01).unwrap().unwrap();
        assert!(changed.contains(&format!("{field} of scan 1 is")), "{changed}");
        let out = move_points(model.as_ref(), &motion).unwrap();
        let after = read(open(&out, ".e57").unwrap().as_ref()).unwrap().0;
        for ([_, wanted], found) in moves.iter().zip(&after) {
            // Half a step of each, at most 18 m away.
            assert!((*wanted - *found).length() < 0.02, "{field}: {found} for {wanted}");
        }
    }
    // Points are farther apart than any range of so many bits is wide, and next to others that stay.
    let mut model = open(&bytes, ".e57").unwrap();
    let before = read(model.as_ref()).unwrap().0;
    let moves: Vec<[DVec3; 2]> =
        before.iter().enumerate().map(|(i, p)| [*p, if i % 2 == 0 { turns(1.0)(*p) } else { *p }]).collect();
    let error = model.make_room(&moves, 0.01).unwrap_err();
    assert!(error.to_string().contains("sphericalAzimuth of scan 1 goes from"), "{error}");
    assert!(error.hint().contains("floats"));
}

#[test]
fn azimuths_all_around_have_room_for_any() {
    let scan = MadeScan {
        fields: vec![
            Made::scaled("sphericalRange", 14, 0.001, 8.0, [5.0; 300]),
            // To the nearest step within half a turn either way.
            Made {
                xml: "<sphericalAzimuth type=\"ScaledInteger\" minimum=\"-3141\" maximum=\"3141\" scale=\"1e-3\"/>".into(),
                bits: 13,
                numbers: (0..300).map(|i| i * 20).collect(),
            },
            Made::scaled("sphericalElevation", 12, 0.001, 0.0, [0.1; 300]),
        ],
        ..MadeScan::default()
    };
    let mut model = open(&make(&[scan], At::End, |left| left), ".e57").unwrap();
    let before = read(model.as_ref()).unwrap().0;
    for angle in [1.0, 2.0, -1.5, std::f64::consts::PI] {
        let turn = |p: DVec3| DQuat::from_rotation_z(angle) * p;
        let moves: Vec<[DVec3; 2]> = before.iter().map(|p| [*p, turn(*p)]).collect();
        assert_eq!(model.make_room(&moves, 0.01).unwrap(), None);
        let out = move_points(model.as_ref(), turn).unwrap();
        let after = read(open(&out, ".e57").unwrap().as_ref()).unwrap().0;
        assert!(moves.iter().zip(&after).all(|([_, wanted], found)| (*wanted - *found).length() < 0.006));
    }
}

#[test]
fn normals_turn_in_their_scan_and_cannot_be_left_out() {
    let mut scan = three(50).swap_remove(0);
    scan.fields.push(Made::single("nor:normalX", [1.0; 50]));
    scan.fields.push(Made::single("nor:normalY", [0.0; 50]));
    scan.fields.push(Made::single("nor:normalZ", [0.0; 50]));
    let bytes = make(&[scan], At::End, |left| left / 2 + 1);
    let model = check_whole(&bytes, ".e57");
    let (rotation, _) = pose();
    let (_, normals) = read(model.as_ref()).unwrap();
    assert!(
        model.info().has_normals
            && normals.iter().all(|n| (n.as_dvec3() - rotation * DVec3::X).length() < 1e-6)
    );
    let mut out = Target::default();
    let edit = |_: &VertexChunk, versions: &mut [Edited]| {
        versions[0].normals.iter_mut().for_each(|n| *n = (rotation * DVec3::Y).as_vec3());
        Ok(())
    };
    model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &Silent).unwrap();
    let (points, _) = by_crate(&out.0);
    let normal = |i: usize| f32::from_bits(points[0][7][8 + i] as u32);
    assert!(normal(0).abs() < 1e-6 && (normal(1) - 1.0).abs() < 1e-6);
    let how = Rewriting { normals: Normals::Drop, ..Rewriting::default() };
    let error = message(model.rewrite(&mut [&mut Target::default()], how, &edit, &Silent));
    assert_eq!(error, "normals cannot be left out of a file of this format");
}

#[test]
fn boxes_of_groups_are_told_to_stay() {
    let groups = "<pointGroupingSchemes type=\"Structure\"><groupingByLine type=\"Structure\"><groups \
         type=\"CompressedVector\"><prototype type=\"Structure\"><startPointIndex type=\"Integer\"/>\
         <cartesianBounds type=\"Structure\"><xMinimum type=\"Float\"/></cartesianBounds></prototype></groups>\
         </groupingByLine></pointGroupingSchemes>";
    for (groups, count) in [(groups.to_owned(), 1), (groups.replace("cartesianBounds", "other"), 0)] {
        let mut scan = three(5).swap_remove(0);
        scan.xml += &groups;
        let model = open(&make(&[scan], At::End, |left| left), ".e57").unwrap();
        let notes = Notes::default();
        let keep = |_: &VertexChunk, _: &mut [Edited]| Ok(());
        model.rewrite(&mut [&mut Target::default()], Rewriting::default(), &keep, &notes).unwrap();
        let notes = notes.0.into_inner().unwrap();
        let are_told =
            notes.iter().all(|note| note.contains("groups of points, as of scan 1, have boxes of their own"));
        assert!(notes.len() == count && are_told, "{notes:?}");
    }
}

/// Single, scaled in odd bits, and double, over several pieces; the second scan has no such numbers.
#[test]
fn declared_numbers_turn_in_their_scan() {
    let count = 60_000;
    let mut next = random(9);
    let mut list = |size: f64| (0..count).map(|_| size * (next() - 0.5)).collect::<Vec<f64>>();
    let positions = ["cartesianX", "cartesianY", "cartesianZ"].map(|name| Made::double(name, list(20.0)));
    let mut posed = MadeScan { fields: positions.to_vec(), xml: POSE.to_owned(), ..MadeScan::default() };
    posed.fields.push(Made::single("nor:v_x", list(2.0)));
    posed.fields.push(Made::integer("colorRed", 8, (0..count as u64).map(|i| i * 7)));
    posed.fields.push(Made::scaled("nor:v_y", 19, 1e-5, 0.0, list(2.0)));
    posed.fields.push(Made::double("nor:v_z", list(2.0)));
    let other = MadeScan { fields: positions.to_vec(), ..MadeScan::default() };
    let bytes = make(&[posed, other], At::End, |left| left / 3 + 1);
    let mut model = open(&bytes, ".e57").unwrap();
    let follow =
        |name: &str| Follow { declared: [(name.to_owned(), TensorKind::Vector)].into(), ..Follow::default() };
    let error = message(model.follow(&follow("w")));
    assert!(error.contains("w_x, w_y, w_z"), "{error}");
    model.follow(&follow("nor:v")).unwrap();
    // Points that stand still keep all bytes.
    assert!(move_points(model.as_ref(), |p| p).unwrap() == bytes);
    let gradient =
        Mat3::from_cols(Vec3::new(0.1, 1.2, 0.0), Vec3::new(-0.9, 0.1, 0.3), Vec3::new(0.0, 0.1, 1.1));
    let mut out = Target::default();
    let edit = |_: &VertexChunk, versions: &mut [Edited]| {
        versions[0].gradients.iter_mut().for_each(|g| *g = gradient);
        Ok(())
    };
    model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &Silent).unwrap();
    let ((before, _), (after, _)) = (by_crate(&bytes), by_crate(&out.0));
    let (rotation, _) = pose();
    let vector = |row: &[u64]| {
        let scaled = (row[5] as f64 - f64::from(1 << 18)) * 1e-5;
        DVec3::new(f64::from(f32::from_bits(row[3] as u32)), scaled, f64::from_bits(row[6]))
    };
    for (old, new) in before[0].iter().zip(&after[0]) {
        let expected = rotation.inverse() * (gradient.as_dmat3() * (rotation * vector(old)));
        assert!((vector(new) - expected).length() < 1e-5, "{} {expected}", vector(new));
        assert!(old[..3] == new[..3] && old[4] == new[4]);
    }
    assert!(before[1] == after[1]);
}

/// A file of the crate's, with 20 000 points, an image and an extension.
fn of_crate() -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut file, "guid").unwrap();
    writer.register_extension(::e57::Extension::new("ext", "https://example.org/ext")).unwrap();
    let record = |name, data_type| Record { name, data_type };
    let scaled = RecordDataType::ScaledInteger { min: -100_000, max: 1_234_567, scale: 0.0005, offset: 1.5 };
    let prototype = vec![
        record(RecordName::CartesianX, scaled.clone()),
        record(RecordName::CartesianY, scaled.clone()),
        record(RecordName::CartesianZ, scaled),
        record(RecordName::Intensity, RecordDataType::Single { min: None, max: None }),
        record(
            RecordName::Unknown { namespace: "ext".into(), name: "class".into() },
            RecordDataType::Integer { min: 3, max: 40 },
        ),
    ];
    let mut cloud = writer.add_pointcloud("cloud", prototype).unwrap();
    cloud.set_name(Some("Hall".into()));
    cloud.set_transform(Some(::e57::Transform {
        rotation: ::e57::Quaternion { w: 0.5, x: 0.5, y: 0.5, z: 0.5 },
        translation: ::e57::Translation { x: 1.0, y: 2.0, z: 3.0 },
    }));
    for i in 0..20_000i64 {
        let int = RecordValue::ScaledInteger;
        cloud
            .add_point(vec![
                int(i * 37 % 90_000),
                int(i * 91 % 80_000),
                int(i % 1000),
                RecordValue::Single(i as f32),
                RecordValue::Integer(3 + i % 38),
            ])
            .unwrap();
    }
    cloud.finalize().unwrap();
    writer.add_blob(&mut Cursor::new(vec![0x55; 5000])).unwrap();
    writer.finalize().unwrap();
    drop(writer);
    file.into_inner()
}

#[test]
fn a_file_of_another_program_is_moved_and_its_image_stays() {
    let bytes = of_crate();
    go_over(&bytes, ".e57").unwrap();
    let model = open(&bytes, ".e57").unwrap();
    assert_eq!(model.besides().unwrap(), ["1 pose"]);
    assert!(model.details()[0].starts_with("scan 1 (Hall): 20000 points, at [1, 2, 3], turned by 120.0000°"));
    let moved = |p: DVec3| p + DVec3::new(0.0, 0.25, 0.0005 * (p.x * 3.0).round());
    let out = move_points(model.as_ref(), moved).unwrap();
    assert_eq!(out.len(), bytes.len());
    assert!(out.windows(4000).any(|w| w.iter().filter(|b| **b == 0x55).count() > 3900));
    let (before, _) = by_crate(&bytes);
    let (after, _) = by_crate(&out);
    let value = |bits: u64| (bits as i64 - 100_000) as f64 * 0.0005 + 1.5;
    for (old, new) in before[0].iter().zip(&after[0]) {
        assert_eq!(old[3..], new[3..]);
        // The pose turns x to y, y to z and z to x.
        let place = |p: &[u64]| DVec3::new(value(p[2]), value(p[0]), value(p[1])) + DVec3::new(1.0, 2.0, 3.0);
        assert!((place(new) - moved(place(old))).abs().max_element() < 0.00025 + 1e-9);
    }
}

#[test]
fn what_is_wrong_is_named() {
    let whole = of_crate();
    let mut spoilt = whole.clone();
    spoilt[2000] ^= 1;
    assert_eq!(message(go_over(&spoilt, ".e57")), "the checksum of page 1, at byte 1024, is wrong");
    let cut = &whole[..whole.len() - 1024];
    let what = format!("the header says {} bytes, but the file has {}", whole.len(), cut.len());
    assert_eq!(message(go_over(cut, ".e57")), what);
    let logical = unpaged(&whole);
    let text = String::from_utf8_lossy(&logical).into_owned();
    let bad = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = logical.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        let mut bytes = logical.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        message(go_over(&paged(&bytes), ".e57"))
    };
    let bomb = "<!DOCTYPE e57Root [<!ENTITY a \"aaaa\"><!ENTITY b \"&a;&a;&a;\">]>";
    let start = text.find("<e57Root").unwrap();
    let from = &text[start..start + bomb.len()];
    let error = bad(from, bomb);
    assert!(error.ends_with("cannot be read: XML with DTD detected"), "{error}");
    let said = "scan 1 (Hall) is said to have 99999 points, but of cartesianX there are";
    assert!(bad("recordCount=\"20000\"", "recordCount=\"99999\"").starts_with(said));
    assert!(bad("</data3D>", "<!data3D>").contains("the XML that describes the scans cannot be read"));
    assert!(bad("fileOffset=\"48\"", "fileOffset=\"52\"").contains("at byte 52: the section is of type"));
    assert!(
        bad("minimum=\"-100000\"", "minimum=\"9999999\"")
            .contains("cartesianX has numbers from 9999999 to 1234567")
    );
    assert!(bad("scale=\"0.0005\"", "scale=\"0.0000\"").contains("has the scale 0"));
    assert!(bad("cartesianZ ", "cartesianQ ").contains("cannot be read"));
    let mut scans = three(5);
    scans[2].xml = ["0.8", "0.36", "0.48"].iter().fold(POSE.to_owned(), |pose, one| pose.replace(one, "0"));
    let error = go_over(&make(&scans, At::End, |left| left), ".e57").unwrap_err();
    let text = error.to_string();
    assert!(text.contains("line ") && text.contains("the pose of scan 3"), "{text}");
    assert!(text.contains("is no rigid motion: its rotation is [0.0, 0.0, 0.0, 0.0]"), "{text}");
    assert!(error.hint().starts_with("register the scan once more"), "{}", error.hint());
}

/// Reads and rewrites a file, in which any error is fine, but no panic.
fn survive(logical: &[u8]) {
    let _ = go_over(&paged(logical), ".e57");
}

#[test]
fn bad_files_are_errors_or_sane() {
    let scans = three(40);
    let mut next = random(3);
    let bytes = make(&scans, At::End, |left| (next() * 100.0) as usize % (left + 7));
    for end in 1..bytes.len() {
        assert!(open(&bytes[..end], ".e57").is_err());
    }
    for at in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[at] ^= 1 << (at % 8);
        assert!(go_over(&bad, ".e57").is_err(), "{at}");
    }
    // With checksums that are right.
    let logical = unpaged(&bytes);
    for at in 0..logical.len() {
        for change in [1, 0x80, 0xff] {
            let mut bad = logical.clone();
            bad[at] ^= change;
            survive(&bad);
        }
    }
    // Whole numbers that lie, in the header and in the head of the section.
    for at in (16..48).step_by(8).chain([64, 72, 80]) {
        for lie in [0, 1, 47, 48, 1023, 1 << 20, 1 << 40, u64::MAX, u64::MAX / 2, u64::MAX - 3] {
            let mut bad = logical.clone();
            bad[at..at + 8].copy_from_slice(&lie.to_le_bytes());
            survive(&bad);
        }
    }
}

proptest! {
    #![proptest_config(cases(24))]

    #[test]
    fn numbers_of_any_width_in_any_packets_move(
        widths in prop::array::uniform3(4u32..=40),
        seed in any::<u64>(),
        count in 1usize..6000,
        most in 1usize..3000,
        skewed in any::<bool>(),
    ) {
        let mut next = random(seed);
        let scale = |bits: u32| 8.0 / (1u64 << bits) as f64;
        let names = ["cartesianX", "cartesianY", "cartesianZ"];
        let mut fields: Vec<Made> = names
            .iter()
            .zip(widths)
            .map(|(name, bits)| Made::scaled(name, bits, scale(bits), 0.0, (0..count).map(|_| 4.0 * (next() - 0.5)).collect::<Vec<_>>()))
            .collect();
        fields.insert(2, Made::integer("intensity", 13, (0..count as u64).map(|i| i * 31)));
        let scans = [MadeScan { fields: fields.clone(), ..MadeScan::default() }];
        let mut turn = 0;
        let bytes = make(&scans, At::End, |left| {
            turn += 1;
            // Whole streams that come late, or any shares.
            if skewed && turn % 4 != 0 { if turn % 8 < 4 { 0 } else { left } } else { (next() * most as f64) as usize + 1 }
        });
        let model = open(&bytes, ".e57").unwrap();
        let out = move_points(model.as_ref(), |p| p + DVec3::new(0.3 * p.y, -0.2 * p.x, 0.1 * p.x * p.y)).unwrap();
        let (before, _) = by_crate(&bytes);
        let (after, _) = by_crate(&out);
        let of = |point: &[u64]| {
            let value = |field: usize| {
                let bits = fields[field].bits;
                (point[field] as f64 - (1u64 << (bits - 1)) as f64) * scale(bits)
            };
            DVec3::new(value(0), value(1), value(3))
        };
        for (old, new) in before[0].iter().zip(&after[0]) {
            prop_assert_eq!(old[2], new[2]);
            let p = of(old);
            let wanted = p + DVec3::new(0.3 * p.y, -0.2 * p.x, 0.1 * p.x * p.y);
            let steps = DVec3::from(widths.map(|bits| 0.500_001 * scale(bits)));
            prop_assert!((of(new) - wanted).abs().cmple(steps).all());
        }
        let identity = move_points(model.as_ref(), |p| p).unwrap();
        prop_assert!(identity == bytes);
    }
}

/// Two chunks of one vertex need not come to the same digits.
#[test]
fn a_number_that_is_divided_between_pieces_is_of_one_mind() {
    let count = 200_000;
    let mut next = random(5);
    let mut list = || (0..count).map(|_| 4.0 * (next() - 0.5)).collect::<Vec<_>>();
    let names = ["cartesianX", "cartesianY", "cartesianZ"];
    let fields = names.map(|name| Made::scaled(name, 37, 1e-10, 0.0, list())).to_vec();
    let bytes = make(&[MadeScan { fields, ..MadeScan::default() }], At::End, |_| 20_000);
    let model = open(&bytes, ".e57").unwrap();
    let groups = Mutex::new(BTreeMap::new());
    let mut out = Target::default();
    // Each call moves elsewhere, but for vertices that come alone.
    let edit = |chunk: &VertexChunk, versions: &mut [Edited]| {
        *groups.lock().unwrap().entry(chunk.len()).or_insert(0) += 1;
        let by = if chunk.len() == 1 { 1.0 } else { 1.0 + 1e-3 * (chunk.len() % 7) as f64 };
        versions[0].positions.iter_mut().for_each(|p| *p *= by);
        Ok(())
    };
    model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &Silent).unwrap();
    let (before, _) = by_crate(&bytes);
    let (after, _) = by_crate(&out.0);
    let value = |bits: u64| (bits as f64 - (1u64 << 36) as f64) * 1e-10;
    for (old, new) in before[0].iter().zip(&after[0]) {
        for (old, new) in old.iter().zip(new) {
            let (old, new) = (value(*old), value(*new));
            let by = (0..7).map(|k| 1.0 + 1e-3 * f64::from(k)).map(|by| (new - by * old).abs());
            assert!(by.fold(1.0, f64::min) < 1e-9, "{old} {new}");
        }
    }
    let groups = groups.into_inner().unwrap();
    assert!(groups[&1] >= 2, "{groups:?}");
    assert!(groups.keys().all(|size| *size <= 1 << 16));
}
