//! LAS and LAZ files of every sort, made here byte by byte or by other libraries, then read, rewritten, cut
//! off and spoilt.

#![allow(clippy::unwrap_used)] // helpers of tests are tests, too

use std::fs;
use std::io::{self, Cursor, Seek, Write};
use std::path::Path;

use glam::{DVec3, Mat3, Vec3};
use laz::las::{Point1, Point3, Point6, Point7};
use laz::{LasZipCompressor, LasZipDecompressor, LazItem, LazItemRecordBuilder, LazVlr, LazVlrBuilder};
use proptest::prelude::*;
use simod_model::follow::{Follow, TensorKind};
use simod_model::progress::Silent;
use simod_model::{
    CHUNK_VERTICES, Colors, Edited, Error, ErrorKind, FaceChunk, Model, Result, Rewriting, VertexChunk,
};
use tempfile::NamedTempFile;

use super::Written;

const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

/// Compression of the points.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Packing {
    Plain,
    /// Blocks of so many points each.
    Fixed(u32),
    /// Blocks of different sizes, around so many points.
    Variable(usize),
}

/// Place of the table of blocks that the file tells.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Table {
    AtFront,
    AtEnd,
    Missing,
}

/// A file to be made.
#[derive(Debug, Clone)]
struct Spec {
    minor: u8,
    format: u8,
    extra: usize,
    /// Descriptions of the extra bytes, if not that the first one is a number.
    described: Vec<u8>,
    scale: DVec3,
    offset: DVec3,
    packing: Packing,
    table: Table,
    /// Contents of EVLRs, and what follows behind them.
    evlrs: Vec<Vec<u8>>,
    copc: bool,
    /// Items of the points' compression, if not the usual ones.
    items: Option<Vec<LazItem>>,
    behind: Vec<u8>,
}

impl Spec {
    fn new(minor: u8, format: u8) -> Self {
        Self {
            minor,
            format,
            extra: 0,
            described: Vec::new(),
            scale: DVec3::new(0.01, 0.01, 0.001),
            offset: DVec3::new(400_000.0, 5_000_000.0, 0.0),
            packing: Packing::Plain,
            table: Table::AtFront,
            evlrs: Vec::new(),
            copc: false,
            items: None,
            behind: Vec::new(),
        }
    }

    fn packed(self, packing: Packing) -> Self {
        Self { packing, ..self }
    }

    fn record(&self) -> usize {
        RECORD_BYTES[usize::from(self.format)] + self.extra
    }

    fn header_len(&self) -> usize {
        match self.minor {
            0..=2 => 227,
            3 => 235,
            _ => 375,
        }
    }

    fn vlr(user: &[u8], id: u16, content: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 54];
        bytes[2..2 + user.len()].copy_from_slice(user);
        bytes[18..20].copy_from_slice(&id.to_le_bytes());
        bytes[20..22].copy_from_slice(&(content.len() as u16).to_le_bytes());
        bytes.extend_from_slice(content);
        bytes
    }

    fn evlr(user: &[u8], id: u16, content: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 60];
        bytes[2..2 + user.len()].copy_from_slice(user);
        bytes[18..20].copy_from_slice(&id.to_le_bytes());
        bytes[20..28].copy_from_slice(&(content.len() as u64).to_le_bytes());
        bytes.extend_from_slice(content);
        bytes
    }

    fn laz_vlr(&self) -> LazVlr {
        let usual = LazItemRecordBuilder::default_for_point_format_id(self.format, self.extra as u16);
        let builder = LazVlrBuilder::new(self.items.clone().unwrap_or_else(|| usual.unwrap()));
        match self.packing {
            Packing::Fixed(size) => builder.with_fixed_chunk_size(size),
            _ => builder.with_variable_chunk_size(),
        }
        .build()
    }

    /// Records whose numbers are not all alike, with these positions.
    fn records(&self, positions: &[[i32; 3]]) -> Vec<u8> {
        let record = self.record();
        let mut all = Vec::new();
        for (i, numbers) in positions.iter().enumerate() {
            let mut bytes: Vec<u8> = (0..record)
                .map(|b| ((i * 7 + b * 13) as u32).wrapping_mul(2_654_435_761).to_be_bytes()[0])
                .collect();
            for axis in 0..3 {
                bytes[4 * axis..4 * axis + 4].copy_from_slice(&numbers[axis].to_le_bytes());
            }
            all.extend_from_slice(&bytes);
        }
        all
    }

    fn build(&self, positions: &[[i32; 3]]) -> Vec<u8> {
        let records = self.records(positions);
        let count = positions.len();
        let mut vlrs = Vec::new();
        if self.copc {
            vlrs.push(Self::vlr(b"copc", 1, &[3; 160]));
            vlrs.push(Self::vlr(b"copc", 10_000, &[5; 20]));
        }
        vlrs.push(Self::vlr(b"LASF_Projection", 2112, b"PROJCS[\"ETRS89 / UTM zone 32N\",GEOGCS[]]\0"));
        if self.packing != Packing::Plain {
            let mut content = Vec::new();
            self.laz_vlr().write_to(&mut content).unwrap();
            vlrs.push(Self::vlr(b"laszip encoded", 22204, &content));
        }
        if self.extra > 0 {
            let mut description = self.described.clone();
            if description.is_empty() {
                description.resize(192, 0);
                description[2] = 1;
                description[4..14].copy_from_slice(b"reflection");
            }
            vlrs.push(Self::vlr(b"LASF_Spec", 4, &description));
        }
        vlrs.push(Self::vlr(b"nobody", 7, b"knows what this is"));
        let mut bytes = vec![0; self.header_len()];
        bytes[..4].copy_from_slice(b"LASF");
        bytes[24..26].copy_from_slice(&[1, self.minor]);
        bytes[26..30].copy_from_slice(b"test");
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(94, &(self.header_len() as u16).to_le_bytes());
        put(100, &(vlrs.len() as u32).to_le_bytes());
        let points = self.header_len() + vlrs.iter().map(Vec::len).sum::<usize>() + 5;
        put(96, &(points as u32).to_le_bytes());
        let flag = if self.packing == Packing::Plain { 0 } else { 0x80 };
        put(104, &[self.format | flag]);
        put(105, &(self.record() as u16).to_le_bytes());
        if self.format < 6 {
            put(107, &(count as u32).to_le_bytes());
        }
        for axis in 0..3 {
            put(131 + 8 * axis, &self.scale[axis].to_le_bytes());
            put(155 + 8 * axis, &self.offset[axis].to_le_bytes());
            let of = |n: Option<i32>| f64::from(n.unwrap_or(0)) * self.scale[axis] + self.offset[axis];
            let numbers = || positions.iter().map(|p| p[axis]);
            put(179 + 16 * axis, &of(numbers().max()).to_le_bytes());
            put(187 + 16 * axis, &of(numbers().min()).to_le_bytes());
        }
        if self.minor == 4 {
            put(247, &(count as u64).to_le_bytes());
        }
        vlrs.iter().for_each(|vlr| bytes.extend_from_slice(vlr));
        bytes.extend_from_slice(b"pad..");
        assert_eq!(bytes.len(), points);
        match self.packing {
            Packing::Plain => bytes.extend_from_slice(&records),
            Packing::Fixed(_) | Packing::Variable(_) => self.pack(&records, &mut bytes),
        }
        let mut evlrs: Vec<Vec<u8>> =
            self.evlrs.iter().map(|content| Self::evlr(b"somebody", 9, content)).collect();
        if self.copc {
            evlrs.insert(evlrs.len() / 2, Self::evlr(b"copc", 1000, &[4; 320]));
        }
        if !evlrs.is_empty() {
            let start = bytes.len() as u64;
            bytes[235..243].copy_from_slice(&start.to_le_bytes());
            bytes[243..247].copy_from_slice(&(evlrs.len() as u32).to_le_bytes());
            evlrs.iter().for_each(|evlr| bytes.extend_from_slice(evlr));
        }
        bytes.extend_from_slice(&self.behind);
        if self.table == Table::AtEnd {
            let place: [u8; 8] = bytes[points..points + 8].try_into().unwrap();
            bytes.extend_from_slice(&place);
            bytes[points..points + 8].copy_from_slice(&(-1i64).to_le_bytes());
        }
        bytes
    }

    /// Appends the records, compressed by the other library.
    fn pack(&self, records: &[u8], bytes: &mut Vec<u8>) {
        let mut cursor = Cursor::new(std::mem::take(bytes));
        cursor.set_position(cursor.get_ref().len() as u64);
        let start = cursor.position() as usize;
        let mut compressor = LasZipCompressor::new(cursor, self.laz_vlr()).unwrap();
        match self.packing {
            Packing::Variable(around) => {
                let (mut left, mut size) = (records, 1);
                while !left.is_empty() {
                    let now = left.len().min(size * self.record());
                    compressor.compress_chunks([&left[..now]]).unwrap();
                    left = &left[now..];
                    size = (size * 5 + 1) % (2 * around) + 1;
                }
            }
            _ => compressor.compress_many(records).unwrap(),
        }
        compressor.done().unwrap();
        *bytes = compressor.into_inner().into_inner();
        if self.table == Table::Missing {
            let at = i64::from_le_bytes(bytes[start..start + 8].try_into().unwrap()) as usize;
            bytes.truncate(at);
            bytes[start..start + 8].copy_from_slice(&(-1i64).to_le_bytes());
        }
    }
}

/// A file with its places, as an independent reading of it has them.
struct Parsed {
    points: usize,
    records: Vec<u8>,
    positions: Vec<DVec3>,
    bounds: [f64; 6],
    vlrs: Vec<Vec<u8>>,
    evlrs: Vec<Vec<u8>>,
}

/// Reads a file by what the specification says, and compressed points by the other library.
fn parse(bytes: &[u8]) -> Parsed {
    let u16_at = |at: usize| u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()) as usize;
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let u64_at = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let f64_at = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let minor = bytes[25];
    let (points, record) = (u32_at(96), u16_at(105));
    let count = if minor == 4 { u64_at(247) } else { u32_at(107) };
    let (mut vlrs, mut at) = (Vec::new(), u16_at(94));
    for _ in 0..u32_at(100) {
        let end = at + 54 + u16_at(at + 20);
        vlrs.push(bytes[at..end].to_vec());
        at = end;
    }
    assert_eq!(&bytes[at..points], b"pad..");
    let mut evlrs = Vec::new();
    if minor == 4 {
        let mut at = u64_at(235);
        for _ in 0..u32_at(243) {
            let end = at + 60 + u64_at(at + 20);
            evlrs.push(bytes[at..end].to_vec());
            at = end;
        }
    }
    let mut records = vec![0; count * record];
    if bytes[104] & 0x80 == 0 {
        records.copy_from_slice(&bytes[points..points + count * record]);
    } else {
        let vlr = vlrs.iter().find(|vlr| vlr[2..].starts_with(b"laszip encoded")).unwrap();
        let vlr = LazVlr::from_buffer(&vlr[54..]).unwrap();
        let mut cursor = Cursor::new(bytes);
        cursor.set_position(points as u64);
        LasZipDecompressor::new(cursor, vlr).unwrap().decompress_many(&mut records).unwrap();
    }
    let position = |record: &[u8]| {
        DVec3::from([0, 1, 2].map(|axis| {
            let number = i32::from_le_bytes(record[4 * axis..4 * axis + 4].try_into().unwrap());
            f64::from(number) * f64_at(131 + 8 * axis) + f64_at(155 + 8 * axis)
        }))
    };
    let positions = records.chunks_exact(record).map(position).collect();
    let bounds = [0, 1, 2, 3, 4, 5].map(|i| f64_at(179 + 8 * i));
    Parsed { points, records, positions, bounds, vlrs, evlrs }
}

fn file(bytes: &[u8]) -> NamedTempFile {
    let mut file = NamedTempFile::new().unwrap();
    file.write_all(bytes).unwrap();
    file
}

fn open(path: &Path) -> Result<Box<dyn Model>> {
    simod_model::open(path)
}

fn rewritten(bytes: &[u8], map: impl Fn(DVec3) -> DVec3 + Sync) -> Result<Vec<u8>> {
    let file = file(bytes);
    let model = open(file.path())?;
    let mut out = Written::default();
    let edit = |_: &VertexChunk, versions: &mut [Edited]| {
        versions.iter_mut().for_each(|v| v.positions.iter_mut().for_each(|p| *p = map(*p)));
        Ok(())
    };
    model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &Silent)?;
    Ok(out.0)
}

/// All positions and attributes, read in chunks of so many vertices from `first` on, and all raw bytes.
fn read(model: &dyn Model, first: u64, size: usize) -> (Vec<DVec3>, Vec<Vec<f64>>, Vec<u8>) {
    let mut reader = model.vertices(first..u64::MAX).unwrap();
    reader.set_chunk(size);
    let (mut chunk, mut positions, mut raw) = (VertexChunk::default(), Vec::new(), Vec::new());
    let mut attributes = vec![Vec::new(); model.info().attributes.len()];
    let mut some = attributes.clone();
    while reader.read(&mut chunk).unwrap() {
        assert_eq!(chunk.first, first + positions.len() as u64);
        assert!(chunk.len() <= size);
        positions.extend_from_slice(&chunk.positions);
        raw.extend_from_slice(chunk.raw());
        model.attributes(&chunk, &mut some).unwrap();
        attributes.iter_mut().zip(&some).for_each(|(all, some)| all.extend_from_slice(some));
    }
    (positions, attributes, raw)
}

fn hills(count: usize) -> Vec<[i32; 3]> {
    (0..count as i32).map(|i| [i % 97 * 100 - 5, i / 97 * 100, (i % 13) * (i % 7) * 50 - 900]).collect()
}

fn formats() -> impl Iterator<Item = (u8, u8)> {
    [(0, 0), (0, 1), (1, 1), (2, 0), (2, 1), (2, 2), (2, 3), (3, 4), (3, 5)]
        .into_iter()
        .chain((0..=10).map(|format| (4, format)))
}

#[test]
fn every_point_format_comes_through_an_identity_byte_by_byte() {
    for (minor, format) in formats() {
        for packing in [Packing::Plain, Packing::Fixed(300), Packing::Variable(50)] {
            for extra in [0, 3] {
                let mut spec = Spec { extra, ..Spec::new(minor, format) }.packed(packing);
                if minor == 4 {
                    spec.evlrs = vec![vec![1; 70_000], b"two".to_vec()];
                }
                if packing == Packing::Plain {
                    spec.behind = b"and more".to_vec();
                }
                let bytes = spec.build(&hills(1000));
                assert!(rewritten(&bytes, |p| p).unwrap() == bytes, "{spec:?}");
            }
        }
    }
}

#[test]
fn what_is_read_is_what_is_there() {
    for (minor, format) in formats() {
        for packing in [Packing::Plain, Packing::Fixed(300), Packing::Variable(50)] {
            let spec = Spec { extra: 1, ..Spec::new(minor, format) }.packed(packing);
            let bytes = spec.build(&hills(1000));
            let file = file(&bytes);
            let model = open(file.path()).unwrap();
            let info = model.info();
            let parsed = parse(&bytes);
            let kind = if packing == Packing::Plain { "" } else { ", LAZ" };
            assert_eq!(info.format, format!("LAS 1.{minor}, point format {format}{kind}"));
            assert_eq!((info.vertices, info.faces, info.has_normals), (1000, 0, false));
            assert_eq!(info.crs.as_deref(), Some("ETRS89 / UTM zone 32N"));
            assert!(info.random_access);
            assert_eq!(info.integers.unwrap().scale, spec.scale);
            let mut faces = FaceChunk::default();
            assert!(!model.faces().unwrap().read(&mut faces).unwrap());
            for (first, size) in [(0, 1), (0, 1000), (0, CHUNK_VERTICES), (299, 100), (999, 5), (1000, 5)] {
                let (positions, _, raw) = read(model.as_ref(), first, size);
                assert_eq!(positions, parsed.positions[first as usize..]);
                if first == 0 {
                    assert_eq!(raw.len() as u64, info.vertex_bytes);
                    // Once, and in order, so that hashes of them agree.
                    assert_eq!(bytes.windows(raw.len()).filter(|window| *window == raw).count(), 1);
                }
            }
            let (_, attributes, _) = read(model.as_ref(), 0, 77);
            let named =
                |name: &str| info.attributes.iter().position(|a| a.name == name).map(|i| &attributes[i]);
            for (i, record) in parsed.records.chunks_exact(spec.record()).enumerate() {
                let u16_at = |at: usize| f64::from(u16::from_le_bytes([record[at], record[at + 1]]));
                let f64_at = |at: usize| f64::from_le_bytes(record[at..at + 8].try_into().unwrap());
                let same = |name: &str, value: f64| {
                    let found = named(name).unwrap()[i];
                    assert!(found.to_bits() == value.to_bits() || found.is_nan(), "{name}: {found} {value}");
                };
                same("intensity", u16_at(12));
                same("user_data", f64::from(record[17]));
                same("reflection", f64::from(record[spec.record() - 1]));
                if format < 6 {
                    same("return_number", f64::from(record[14] & 7));
                    same("number_of_returns", f64::from(record[14] >> 3 & 7));
                    same("classification", f64::from(record[15] & 31));
                    same("scan_angle", f64::from(record[16] as i8));
                    same("point_source_id", u16_at(18));
                } else {
                    same("return_number", f64::from(record[14] & 15));
                    same("number_of_returns", f64::from(record[14] >> 4));
                    same("classification", f64::from(record[16]));
                    same("scan_angle", f64::from(i16::from_le_bytes([record[18], record[19]])));
                    same("point_source_id", u16_at(20));
                    same("gps_time", f64_at(22));
                }
                if let Some(at) = match format {
                    2 => Some(20),
                    3 | 5 => Some(28),
                    7 | 8 | 10 => Some(30),
                    _ => None,
                } {
                    same("red", u16_at(at));
                    same("green", u16_at(at + 2));
                    same("blue", u16_at(at + 4));
                } else {
                    assert!(named("red").is_none());
                }
                if matches!(format, 8 | 10) {
                    same("nir", u16_at(36));
                }
                if matches!(format, 1 | 3 | 4 | 5) {
                    same("gps_time", f64_at(20));
                }
            }
        }
    }
}

/// A coordinate system without a code has its name in GeoKeys, as programs wrote it before WKT.
#[test]
fn a_coordinate_system_without_a_code_has_its_name() {
    let mut built = Spec::new(2, 1).build(&hills(10));
    // Its WKT becomes what nobody knows.
    built[227 + 18] += 1;
    let crs = |keys: &[[u16; 4]], texts: &[u8]| {
        let keys = [&[[1, 1, 0, keys.len() as u16]], keys].concat();
        let keys: Vec<u8> = keys.as_flattened().iter().flat_map(|n| n.to_le_bytes()).collect();
        let vlrs = [(34735, &keys[..]), (34737, texts)]
            .map(|(id, content)| Spec::vlr(b"LASF_Projection", id, content));
        let vlrs = vlrs.concat();
        let mut bytes = [&built[..227], &vlrs, &built[227..]].concat();
        for (at, more) in [(96, vlrs.len() as u32), (100, 2)] {
            let number = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) + more;
            bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
        }
        open(file(&bytes).path()).unwrap().info().crs.clone()
    };
    let texts = b"all of it|my own|\0";
    let (all, own) = ([1026, 34737, 10, 0], [3073, 34737, 7, 10]);
    assert_eq!(crs(&[[3072, 0, 1, 32632], own], texts).as_deref(), Some("EPSG:32632"));
    assert_eq!(crs(&[all, [3072, 0, 1, 32767], own], texts).as_deref(), Some("my own"));
    assert_eq!(crs(&[all], texts).as_deref(), Some("all of it"));
    for lie in [[1026, 34737, 10, 9999], [1026, 34736, 10, 0], [1026, 34737, 0, 3]] {
        assert_eq!(crs(&[lie], texts), None, "{lie:?}");
    }
    assert_eq!(crs(&[[1026, 34737, 9999, 10]], texts).as_deref(), Some("my own"));
}

/// Units from GeoKeys, and from WKT that tells nothing itself.
#[test]
fn units_are_told_as_far_as_they_are_declared() {
    let mut built = Spec::new(2, 1).build(&hills(10));
    // Its WKT becomes what nobody knows.
    built[227 + 18] += 1;
    let told = |keys: &[[u16; 4]], wkt: Option<&[u8]>| {
        let keys = [&[[1, 1, 0, keys.len() as u16]], keys].concat();
        let keys: Vec<u8> = keys.as_flattened().iter().flat_map(|n| n.to_le_bytes()).collect();
        let numbers = 0.3333f64.to_le_bytes();
        let all = [(34735, &keys[..]), (34736, &numbers)].into_iter().chain(wkt.map(|wkt| (2112, wkt)));
        let vlrs: Vec<Vec<u8>> =
            all.map(|(id, content)| Spec::vlr(b"LASF_Projection", id, content)).collect();
        let (count, vlrs) = (vlrs.len() as u32, vlrs.concat());
        let mut bytes = [&built[..227], &vlrs, &built[227..]].concat();
        for (at, more) in [(96, vlrs.len() as u32), (100, count)] {
            let number = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) + more;
            bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
        }
        let model = open(file(&bytes).path()).unwrap();
        (model.details().join("; "), model.info().crs.clone().unwrap_or_default())
    };
    let unit = |keys: &[[u16; 4]]| told(keys, None).0;
    assert_eq!(
        unit(&[[3072, 0, 1, 25832], [3076, 0, 1, 9001], [4099, 0, 1, 9003]]),
        "unit: metre, US survey foot"
    );
    assert_eq!(unit(&[[1024, 0, 1, 2], [2048, 0, 1, 4807], [2054, 0, 1, 9105]]), "unit: grad");
    assert_eq!(unit(&[[1024, 0, 1, 2], [2048, 0, 1, 4326]]), "unit: degree");
    assert_eq!(unit(&[[2048, 0, 1, 4326], [2054, 0, 1, 9102]]), "unit: degree");
    assert_eq!(unit(&[[1024, 0, 1, 3], [2048, 0, 1, 4978]]), "unit: metre");
    assert_eq!(unit(&[[3072, 0, 1, 32767], [3076, 0, 1, 32767], [3077, 34736, 1, 0]]), "unit: 0.3333 metres");
    // The projected system's own, though that which it is projected from has another.
    assert_eq!(unit(&[[2054, 0, 1, 9102], [3072, 0, 1, 25832], [3076, 0, 1, 9001]]), "unit: metre");
    for lie in [[3077, 34736, 1, 1], [3077, 34736, 1, 9999], [3077, 0, 1, 5]] {
        assert_eq!(unit(&[[3076, 0, 1, 32767], lie]), "", "{lie:?}");
    }
    let keys = [[3072, 0, 1, 2056], [3076, 0, 1, 9001]];
    for empty in [&b""[..], b"\0\0\0", b" \0"] {
        assert_eq!(told(&keys, Some(empty)), ("unit: metre".to_owned(), "EPSG:2056".to_owned()));
    }
    let wkt = b"PROJCS[\"Here\",UNIT[\"foot\",0.3]]\0";
    assert_eq!(told(&keys, Some(wkt)), ("unit: foot".to_owned(), "Here".to_owned()));
}

/// Waveforms in a file of their own stay there, which is told.
#[test]
fn waveforms_beside_a_file_are_told() {
    struct Notes(std::sync::Mutex<Vec<String>>);
    impl simod_model::Progress for Notes {
        fn begin(&self, _: &'static str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            false
        }
        fn note(&self, text: &str) {
            self.0.lock().unwrap().push(text.to_owned());
        }
    }
    for (encoding, format, count) in [(4, 9, 1), (2, 9, 0), (4, 6, 0)] {
        let mut bytes = Spec::new(4, format).build(&hills(10));
        bytes[6] = encoding;
        let file = file(&bytes);
        let model = open(file.path()).unwrap();
        let notes = Notes(Default::default());
        let keep = |_: &VertexChunk, _: &mut [Edited]| Ok(());
        let mut out = Written::default();
        model.rewrite(&mut [&mut out], Rewriting::default(), &keep, &notes).unwrap();
        let notes = notes.0.into_inner().unwrap();
        assert!(
            notes.len() == count && notes.iter().all(|note| note.contains(".wdp, which is not copied")),
            "{notes:?}"
        );
    }
}

/// Moves a part of the points, and compares all that has to stay and all that has to change.
fn check_moved(spec: &Spec, positions: &[[i32; 3]], map: impl Fn(DVec3) -> DVec3 + Sync) {
    let bytes = spec.build(positions);
    let out = rewritten(&bytes, &map).unwrap();
    let (before, after) = (parse(&bytes), parse(&out));
    let record = spec.record();
    assert_eq!(before.records.len(), after.records.len());
    let pairs = before.records.chunks_exact(record).zip(after.records.chunks_exact(record));
    for (i, (old, new)) in pairs.enumerate() {
        assert_eq!(old[12..], new[12..], "vertex {i}");
        let (at, to) = (before.positions[i], map(before.positions[i]));
        for axis in 0..3 {
            if at[axis] == to[axis] {
                assert_eq!(old[4 * axis..4 * axis + 4], new[4 * axis..4 * axis + 4]);
            } else {
                let off = (after.positions[i][axis] - to[axis]).abs();
                assert!(off <= spec.scale[axis].abs() * 0.500_001 + to[axis].abs() * 4.0 * f64::EPSILON);
            }
        }
    }
    for axis in 0..3 {
        let all = || after.positions.iter().map(|p| p[axis]);
        assert_eq!(after.bounds[2 * axis], all().fold(f64::NEG_INFINITY, f64::max));
        assert_eq!(after.bounds[2 * axis + 1], all().fold(f64::INFINITY, f64::min));
    }
    let keeps = |record: &&Vec<u8>| !record[2..].starts_with(b"copc\0");
    assert!(after.vlrs.iter().eq(before.vlrs.iter().filter(keeps)));
    assert!(after.evlrs.iter().eq(before.evlrs.iter().filter(keeps)));
    assert!(out.ends_with(&spec.behind));
    // The file that was written can be read.
    let file = file(&out);
    let model = open(file.path()).unwrap();
    assert_eq!(read(model.as_ref(), 0, 1000).0, after.positions);
    if spec.packing == Packing::Plain {
        let count = bytes.iter().zip(&out).take(before.points).filter(|(a, b)| a != b).count();
        assert!(count <= 48 && bytes.len() == out.len());
    }
}

/// A wave in a part of the model, which leaves the rest.
fn wave(p: DVec3) -> DVec3 {
    if p.x > 400_050.0 { p + DVec3::new(0.1, -3.0, (p.x * 0.3).sin() * 5.0) } else { p }
}

#[test]
fn positions_move_and_the_rest_stays() {
    for (minor, format) in formats() {
        for packing in [Packing::Plain, Packing::Fixed(100), Packing::Variable(40)] {
            for extra in [0, 2] {
                let mut spec = Spec { extra, ..Spec::new(minor, format) }.packed(packing);
                if minor == 4 {
                    spec.evlrs = vec![b"one".to_vec(), vec![7; 3000]];
                    spec.behind = b"and more".to_vec();
                }
                check_moved(&spec, &hills(1000), wave);
                check_moved(&spec, &hills(1), |p| p + DVec3::ONE);
            }
        }
    }
}

#[test]
fn all_versions_of_the_compression() {
    let items = [
        (1, LazItemRecordBuilder::version_1_of::<Point1>(2)),
        (3, LazItemRecordBuilder::version_2_of::<Point3>(2)),
        (6, LazItemRecordBuilder::version_3_of::<Point6>(2)),
        (6, LazItemRecordBuilder::version_4_of::<Point6>(2)),
        (7, LazItemRecordBuilder::version_4_of::<Point7>(2)),
    ];
    for (format, items) in items {
        let spec = Spec { extra: 2, items: Some(items), ..Spec::new(4, format) }.packed(Packing::Fixed(90));
        let bytes = spec.build(&hills(500));
        assert!(rewritten(&bytes, |p| p).unwrap() == bytes);
        check_moved(&spec, &hills(500), wave);
    }
    let items = Some(LazItemRecordBuilder::version_1_of::<Point3>(0));
    let spec = Spec { items, ..Spec::new(2, 3) }.packed(Packing::Fixed(90));
    let error = refused(&spec.build(&hills(500)));
    assert!(error.to_string().contains("colours of the first version"), "{error}");
}

#[test]
fn the_octree_of_copc_is_left_out() {
    for format in 6..=8 {
        for evlrs in [vec![], vec![b"one".to_vec(), b"two".to_vec(), b"three".to_vec()]] {
            let spec = Spec { copc: true, evlrs, ..Spec::new(4, format) }.packed(Packing::Variable(60));
            let file = file(&spec.build(&hills(500)));
            assert!(open(file.path()).unwrap().info().format.ends_with(", LAZ, COPC"));
            check_moved(&spec, &hills(500), wave);
            check_moved(&spec, &hills(500), |p| p);
        }
    }
}

#[test]
fn tables_at_the_end_or_missing() {
    for format in [1, 3, 6, 7] {
        for packing in [Packing::Fixed(100), Packing::Variable(40)] {
            let spec = Spec { table: Table::AtEnd, ..Spec::new(4, format) }.packed(packing);
            let bytes = spec.build(&hills(1000));
            assert!(rewritten(&bytes, |p| p).unwrap() == bytes);
            check_moved(&spec, &hills(1000), wave);
            let spec = Spec { table: Table::Missing, ..spec };
            let bytes = spec.build(&hills(1000));
            if packing == Packing::Variable(40) && format < 6 {
                // Nothing says where a block ends.
                assert_eq!(open(file(&bytes).path()).err().unwrap().kind(), ErrorKind::Format);
                continue;
            }
            assert!(rewritten(&bytes, |p| p).unwrap() == bytes);
            let out = rewritten(&bytes, wave).unwrap();
            let positions = |bytes: &[u8]| read(open(file(bytes).path()).unwrap().as_ref(), 0, 100).0;
            for (old, new) in positions(&bytes).into_iter().zip(positions(&out)) {
                assert!(wave(old).distance(new) <= 0.01);
            }
        }
    }
}

#[test]
fn large_coordinates_keep_their_digits() {
    let mut spec = Spec::new(4, 6);
    spec.scale = DVec3::splat(1e-4);
    spec.offset = DVec3::new(4_157_222.543, 664_789.307, 4_774_952.099);
    check_moved(&spec, &hills(100), |p| if p.z > 4_774_952.1 { p + 0.000_3 } else { p });
    spec.scale = DVec3::new(-0.01, 1e-7, 3.0);
    check_moved(&spec, &hills(100), |p| p * 1.000_001);
}

fn refused(bytes: &[u8]) -> Error {
    open(file(bytes).path()).err().unwrap()
}

#[test]
fn what_leaves_the_integers_is_an_error_with_a_way_out() {
    for packing in [Packing::Plain, Packing::Fixed(300)] {
        let spec = Spec::new(2, 1).packed(packing);
        let bytes = spec.build(&hills(1000));
        let error = rewritten(&bytes, |p| p + DVec3::X * 3e7).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Degenerate);
        let text = error.to_string();
        assert!(text.contains("vertex 0 moves to x = 30399999.95"), "{text}");
        assert!(text.contains("-21074836.48 to 21874836.47"), "{text}");
        assert!(error.hint().contains("--offset auto"), "{}", error.hint());
        let error = rewritten(&bytes, |p| DVec3::new(p.x, f64::NAN, p.z)).unwrap_err();
        assert!(error.to_string().contains("moves vertex 0 to NaN"), "{error}");
    }
}

#[test]
fn files_of_the_other_library_come_through() {
    use las::{Builder, Color, Point, Writer};
    for (version, format) in [((1, 2), 3), ((1, 4), 7)] {
        for compressed in [false, true] {
            let mut builder = Builder::from(version);
            builder.point_format = las::point::Format::new(format).unwrap();
            builder.point_format.is_compressed = compressed;
            let transform = las::Transform { scale: 0.001, offset: 1000.0 };
            builder.transforms = las::Vector { x: transform, y: transform, z: transform };
            let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
            for i in 0..3000 {
                let t = f64::from(i) * 0.01;
                let color = Some(Color::new(i as u16, 2, 3));
                let (x, y, z) = (1000.0 + t.cos(), 1000.0 + t.sin(), 1000.0 + t);
                writer
                    .write_point(Point {
                        x,
                        y,
                        z,
                        color,
                        gps_time: Some(t),
                        intensity: 7,
                        ..Point::default()
                    })
                    .unwrap();
            }
            let bytes = writer.into_inner().unwrap().into_inner();
            assert!(rewritten(&bytes, |p| p).unwrap() == bytes);
            let out = rewritten(&bytes, |p| p + DVec3::Z * 5.0).unwrap();
            let mut before = las::Reader::new(Cursor::new(bytes)).unwrap();
            let mut after = las::Reader::new(Cursor::new(out)).unwrap();
            for (old, new) in before.read_all().unwrap().points().zip(after.read_all().unwrap().points()) {
                let (old, new) = (old.unwrap(), new.unwrap());
                assert!((new.z - old.z - 5.0).abs() < 1e-9);
                assert_eq!(Point { z: old.z, ..new }, old);
            }
            let (old, new) = (before.header().bounds(), after.header().bounds());
            // The library gives its own bounds a step more.
            assert!((new.max.z - old.max.z - 5.0).abs() < 0.0011 && new.min.x == old.min.x);
        }
    }
}

#[test]
fn every_truncation_is_noticed() {
    for (minor, format, packing) in [
        (2, 3, Packing::Plain),
        (4, 6, Packing::Plain),
        (2, 3, Packing::Fixed(10)),
        (4, 7, Packing::Variable(6)),
    ] {
        let mut spec = Spec::new(minor, format).packed(packing);
        if minor == 4 {
            spec.evlrs = vec![b"one".to_vec()];
        }
        let bytes = spec.build(&hills(30));
        for end in 0..bytes.len() {
            match rewritten(&bytes[..end], |p| p) {
                Ok(_) => panic!("{end} of {} bytes pass ({spec:?})", bytes.len()),
                Err(error) => assert!(!error.hint().is_empty()),
            }
        }
    }
}

#[test]
fn lies_are_noticed() {
    let plain = Spec::new(4, 6).build(&hills(100));
    let spoilt = |bytes: &[u8], at: usize, value: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes[at..at + value.len()].copy_from_slice(value);
        bytes
    };
    for (at, value, told) in [
        (24, &[2, 0][..], "a file of LAS 2.0"),
        (24, &[1, 5][..], "a file of LAS 1.5"),
        (94, &[1, 0], "needs 375"),
        (94, &[255, 255], "within the header"),
        (96, &[255; 4], "the points begin at byte"),
        (100, &[255; 4], "VLR "),
        (104, &[11], "point format 11"),
        (104, &[0x86], "laszip encoded"),
        (105, &[29, 0], "needs 30 bytes"),
        (105, &[255, 255], "says 100 points of 65535 bytes each"),
        (131, &[0; 8], "scale"),
        (139, &[255; 8], "scale"),
        (155, &[255; 8], "scale"),
        (247, &[255; 8], "points of 30 bytes each"),
        (395, &[255; 2], "goes on where the points begin"),
    ] {
        let error = refused(&spoilt(&plain, at, value));
        assert!(error.to_string().contains(told), "{error}");
        assert!(!error.hint().is_empty());
    }
    let packed = Spec::new(4, 6).packed(Packing::Fixed(10)).build(&hills(100));
    let points = parse(&packed).points;
    let table = u64::from_le_bytes(packed[points..points + 8].try_into().unwrap()) as usize;
    let laszip = packed.windows(14).position(|window| window == b"laszip encoded").unwrap() + 52;
    for (at, value, told) in [
        (
            points,
            &[255, 255, 255, 255, 255, 255, 255, 127][..],
            "the table of compressed blocks is said to be",
        ),
        (table + 4, &[255; 4], "it has 4294967295 blocks"),
        (table + 4, &[3, 0, 0, 0], "of the 100 points of the file"),
        (laszip, &[9, 0], "cannot be used"),
        (laszip + 12, &[255, 255, 255, 254], "compressed block 1 at byte"),
        (laszip + 32, &[0, 0], "cannot be used"),
        (laszip + 32, &[255, 255], "cannot be used"),
    ] {
        let error = match open(file(&spoilt(&packed, at, value)).path()) {
            Err(error) => error,
            Ok(_) => rewritten(&spoilt(&packed, at, value), |p| p + 1.0).unwrap_err(),
        };
        assert!(error.to_string().contains(told), "{told}: {error}");
        assert!(!error.hint().is_empty());
    }
    // The layers of a block say that they are longer than the file.
    let error = rewritten(&spoilt(&packed, points + 8 + 34, &[255; 4]), |p| p + 1.0).unwrap_err();
    assert!(error.to_string().contains("compressed block 0 cannot be read"), "{error}");
}

#[test]
fn blocks_that_are_too_large_to_be_held_are_refused() {
    let count = (1 << 18) + 1;
    let positions: Vec<[i32; 3]> = (0..count).map(|i| [i, 0, 0]).collect();
    let bytes = Spec::new(2, 0).packed(Packing::Fixed(u32::MAX - 1)).build(&positions);
    let error = refused(&bytes);
    assert!(error.to_string().contains("has 262145 points"), "{error}");
    assert!(error.hint().contains("pdal"), "{}", error.hint());
    let bytes = Spec::new(2, 0).packed(Packing::Fixed(u32::MAX - 1)).build(&positions[..count as usize - 1]);
    assert!(rewritten(&bytes, |p| p).unwrap() == bytes);
}

fn spec() -> impl Strategy<Value = (Spec, Vec<[i32; 3]>)> {
    let packing = prop_oneof![
        Just(Packing::Plain),
        (1u32..400).prop_map(Packing::Fixed),
        (1usize..200).prop_map(Packing::Variable),
    ];
    let number = prop_oneof![-1000..1000i32, any::<i32>().prop_map(|i| i / 4)];
    let evlrs = prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..3);
    let formats = prop::sample::select(formats().collect::<Vec<_>>());
    let positions = prop::collection::vec(prop::array::uniform3(number), 1..700);
    (formats, packing, 0usize..5, evlrs, positions, prop::array::uniform3(-5..2)).prop_map(
        |((minor, format), packing, extra, evlrs, positions, digits)| {
            let scale = DVec3::from(digits.map(|n: i32| 10f64.powi(n)));
            let mut spec = Spec { extra, scale, ..Spec::new(minor, format) }.packed(packing);
            if minor == 4 {
                spec.evlrs = evlrs;
            }
            (spec, positions)
        },
    )
}

/// Number of cases, unless the environment sets another.
fn cases(count: u32) -> ProptestConfig {
    let usual = ProptestConfig::default();
    if std::env::var_os("PROPTEST_CASES").is_some() {
        usual
    } else {
        ProptestConfig { cases: count, ..usual }
    }
}

proptest! {
    #![proptest_config(cases(32))]

    #[test]
    fn any_file_comes_through((spec, positions) in spec(), part in 0.0..1.0f64) {
        let bytes = spec.build(&positions);
        prop_assert!(rewritten(&bytes, |p| p).unwrap() == bytes);
        let middle = spec.offset.x + spec.scale.x * 1000.0 * part;
        let scale = spec.scale;
        check_moved(&spec, &positions, move |p| if p.x > middle { p + scale * DVec3::new(3.2, 0.0, -7.7) } else { p });
    }

    /// Whatever a file says: an error or a model, but no panic, and no more memory than the file has.
    #[test]
    fn no_bytes_are_too_bad(
        (spec, positions) in spec(),
        spoilt in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = spec.build(&positions);
        for (at, byte) in spoilt {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Err(error) = rewritten(&bytes, |p| p + 1.0) {
            prop_assert!(!error.hint().is_empty());
        }
    }
}

#[test]
fn positions_alone_are_the_same_and_so_are_the_bytes() {
    for (minor, format) in formats() {
        for packing in [Packing::Plain, Packing::Fixed(300), Packing::Variable(50)] {
            let bytes = Spec { extra: 2, ..Spec::new(minor, format) }.packed(packing).build(&hills(1000));
            let file = file(&bytes);
            let model = open(file.path()).unwrap();
            let (expected, _, raw) = read(model.as_ref(), 0, 77);
            let mut reader = model.vertices(0..1000).unwrap();
            reader.skip_attributes();
            reader.set_chunk(77);
            let (mut chunk, mut positions, mut bytes) = (VertexChunk::default(), Vec::new(), Vec::new());
            while reader.read(&mut chunk).unwrap() {
                positions.extend_from_slice(&chunk.positions);
                bytes.extend_from_slice(chunk.raw());
            }
            assert!(positions == expected && bytes == raw);
        }
    }
}

/// Positions and colours, of the vertices from one on.
fn read_colors(model: &dyn Model, first: u64) -> (Vec<DVec3>, Vec<Vec<f64>>) {
    let colors = Colors::from_info(model.info());
    let mut reader = model.vertices(first..u64::MAX).unwrap();
    if colors.is_some() {
        reader.skip_all_but_colors()
    } else {
        reader.skip_attributes()
    }
    reader.set_chunk(77);
    let (mut positions, mut all) = (Vec::new(), vec![Vec::new(); 3]);
    let (mut chunk, mut some) = (VertexChunk::default(), vec![Vec::new(); 3]);
    while reader.read(&mut chunk).unwrap() {
        positions.extend_from_slice(&chunk.positions);
        if let Some(colors) = &colors {
            model.some_attributes(&chunk, &colors.places, &mut some).unwrap();
            all.iter_mut().zip(&some).for_each(|(all, some)| all.extend_from_slice(some));
        }
    }
    (positions, all)
}

#[test]
fn what_is_kept_for_a_second_reading_is_what_was_read() {
    let folder = tempfile::tempdir().unwrap();
    for (minor, format) in formats() {
        for packing in [Packing::Fixed(300), Packing::Variable(50)] {
            let spec = Spec { extra: 2, ..Spec::new(minor, format) }.packed(packing);
            let there = spec.build(&hills(1000));
            let file = file(&there);
            let model = open(file.path()).unwrap();
            let (expected, all, _) = read(model.as_ref(), 0, 100);
            model.keep_positions(Some(folder.path()));
            for first in [0, 555, 1, 0] {
                let (positions, colors) = read_colors(model.as_ref(), first);
                assert_eq!(
                    positions,
                    expected[first as usize..],
                    "LAS 1.{minor}, format {format}, {packing:?}"
                );
                if let Some(places) = Colors::from_info(model.info()).map(|colors| colors.places) {
                    let wanted = places.map(|place| &all[place][first as usize..]);
                    assert_eq!(colors, wanted, "LAS 1.{minor}, format {format}, {packing:?}");
                }
            }
            // Somebody writes the file meanwhile: of the first point another x, from which others count.
            let at = u32::from_le_bytes(there[96..100].try_into().unwrap()) as usize + 8;
            let mut open = file.as_file();
            open.seek(io::SeekFrom::Start(at as u64)).unwrap();
            open.write_all(&[there[at] ^ 1]).unwrap();
            let now = read_colors(model.as_ref(), 0).0;
            assert!(now[0] != expected[0] && now[999] == expected[999]);
            model.keep_positions(None);
            assert_eq!(read_colors(model.as_ref(), 0).0, now);
        }
    }
}

#[test]
fn extra_bytes_that_are_called_colours_are_read_as_such() {
    let description = |name: &[u8]| {
        let mut one = vec![0; 192];
        one[2] = 3;
        one[4..4 + name.len()].copy_from_slice(name);
        one
    };
    let described = [&b"red"[..], b"green", b"blue"].map(description).concat();
    for (minor, format) in [(2, 1), (4, 6)] {
        let spec = Spec { extra: 6, described: described.clone(), ..Spec::new(minor, format) };
        let file = file(&spec.packed(Packing::Fixed(300)).build(&hills(1000)));
        let model = open(file.path()).unwrap();
        let places = Colors::from_info(model.info()).expect("colours").places;
        let (_, all, _) = read(model.as_ref(), 0, 100);
        model.keep_positions(Some(std::env::temp_dir().as_path()));
        for _ in 0..2 {
            assert_eq!(read_colors(model.as_ref(), 0).1, places.map(|place| all[place].clone()));
        }
    }
}

/// Descriptions of scaled numbers of 16 bits, three of a vector and one of a whole number with 64 bits beside
/// them, which say how far they reach.
fn described_vector(positions: &[[i32; 3]], spec: &Spec) -> Vec<u8> {
    let mut all = Vec::new();
    let records = spec.records(positions);
    for (i, name) in [&b"v_x"[..], b"v_y", b"v_z"].into_iter().enumerate() {
        let mut one = vec![0; 192];
        one[2..4].copy_from_slice(&[4, 2 | 4 | 8 | 16]);
        one[4..4 + name.len()].copy_from_slice(name);
        let reach = reach(&records, spec, i);
        one[64..72].copy_from_slice(&reach[0].to_le_bytes());
        one[88..96].copy_from_slice(&reach[1].to_le_bytes());
        one[112..120].copy_from_slice(&0.25f64.to_le_bytes());
        one[136..144].copy_from_slice(&0.0f64.to_le_bytes());
        all.extend_from_slice(&one);
    }
    for name in [&b"w_x"[..], b"w_y", b"w_z"] {
        let mut one = vec![0; 192];
        one[2] = 8;
        one[4..4 + name.len()].copy_from_slice(name);
        all.extend_from_slice(&one);
    }
    all
}

/// One of the numbers of 16 bits in each record.
fn shorts(records: &[u8], spec: &Spec, i: usize) -> Vec<i64> {
    let at = RECORD_BYTES[usize::from(spec.format)] + 2 * i;
    let short = |record: &[u8]| i64::from(i16::from_le_bytes(record[at..at + 2].try_into().unwrap()));
    records.chunks_exact(spec.record()).map(short).collect()
}

fn reach(records: &[u8], spec: &Spec, i: usize) -> [i64; 2] {
    let numbers = shorts(records, spec, i);
    [*numbers.iter().min().unwrap(), *numbers.iter().max().unwrap()]
}

#[test]
fn extra_bytes_turn_and_say_how_far_they_reach() {
    let positions = hills(1000);
    for packing in [Packing::Plain, Packing::Fixed(300), Packing::Variable(50)] {
        let mut spec = Spec { extra: 30, ..Spec::new(4, 6) }.packed(packing);
        spec.described = described_vector(&positions, &spec);
        let bytes = spec.build(&positions);
        let before = parse(&bytes);
        let file = file(&bytes);
        let mut model = open(file.path()).unwrap();
        assert!(model.following().is_none());
        let declared = |name: &str| {
            let declared = [(name.to_owned(), TensorKind::Vector)].into();
            Follow { declared, ..Follow::default() }
        };
        let error = model.follow(&declared("w")).unwrap_err();
        assert!(error.to_string().contains("w_x is a whole number of 64 bits"), "{error:?}");
        model.follow(&declared("v")).unwrap();
        // A quarter turn about z for half of the vertices.
        let turn = Mat3::from_cols(Vec3::Y, -Vec3::X, Vec3::Z);
        let edit = |chunk: &VertexChunk, versions: &mut [Edited]| {
            for (i, gradient) in versions[0].gradients.iter_mut().enumerate() {
                *gradient = if (chunk.first as usize + i).is_multiple_of(2) { turn } else { Mat3::IDENTITY };
            }
            Ok(())
        };
        let mut out = Written::default();
        model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &Silent).unwrap();
        let after = parse(&out.0);
        let [x, y, z] = [0, 1, 2].map(|i| shorts(&before.records, &spec, i));
        let found = [0, 1, 2].map(|i| shorts(&after.records, &spec, i));
        for i in 0..positions.len() {
            // A number that does not fit its type stays.
            let opposite = if y[i] == -32768 { x[i] } else { -y[i] };
            let expected = if i % 2 == 0 { [opposite, x[i], z[i]] } else { [x[i], y[i], z[i]] };
            assert_eq!(found.each_ref().map(|of| of[i]), expected);
        }
        let told = after.vlrs.iter().find(|vlr| vlr[2..].starts_with(b"LASF_Spec")).unwrap();
        for i in 0..3 {
            let at = |at: usize| i64::from_le_bytes(told[54 + 192 * i + at..][..8].try_into().unwrap());
            assert_eq!([at(64), at(88)], reach(&after.records, &spec, i));
        }
        // Beside the vector and what is told of it, nothing changed.
        let extra = RECORD_BYTES[6];
        let rest = |records: &[u8]| -> Vec<u8> {
            let records = records.chunks_exact(spec.record());
            records.flat_map(|record| [&record[..extra], &record[extra + 6..]].concat()).collect()
        };
        assert!(rest(&before.records) == rest(&after.records) && before.bounds == after.bounds);
    }
}

#[test]
fn another_offset_leaves_positions_where_they_are() {
    for packing in [Packing::Plain, Packing::Fixed(300)] {
        let bytes = Spec::new(4, 7).packed(packing).build(&hills(1000));
        let file = file(&bytes);
        let mut model = open(file.path()).unwrap();
        let moves: Vec<[DVec3; 2]> =
            parse(&bytes).positions.iter().map(|p| [*p, *p + DVec3::X * 3e7]).collect();
        assert_eq!(model.make_room(&[[moves[0][0]; 2]], 0.0).unwrap(), None);
        let changed = model.make_room(&moves, 5.0).unwrap().unwrap();
        assert!(changed.contains("the offset of the positions becomes (3"), "{changed}");
        let mut out = Written::default();
        let edit = |_: &VertexChunk, versions: &mut [Edited]| {
            versions.iter_mut().for_each(|v| v.positions.iter_mut().for_each(|p| p.x += 3e7));
            Ok(())
        };
        model.rewrite(&mut [&mut out], Rewriting::default(), &edit, &Silent).unwrap();
        let (before, after) = (parse(&bytes), parse(&out.0));
        for (old, new) in before.positions.iter().zip(&after.positions) {
            assert!((*new - *old - DVec3::X * 3e7).abs().max_element() < 1e-6);
        }
        assert_eq!(after.bounds[5], after.positions.iter().map(|p| p.z).fold(f64::INFINITY, f64::min));
        assert_eq!(after.records[8..12], (-900i32).to_le_bytes());
    }
}

/// The records of a compressed file are made of what the format says.
#[test]
fn items_of_all_formats_are_known() {
    for format in 0..=10 {
        let items = LazItemRecordBuilder::default_for_point_format_id(format, 0).unwrap();
        let bytes: u16 = items.iter().map(|item| item.size()).sum();
        assert_eq!(usize::from(bytes), RECORD_BYTES[usize::from(format)]);
    }
    let path = tempfile::tempdir().unwrap().path().join("none.las");
    fs::metadata(&path).unwrap_err();
}
