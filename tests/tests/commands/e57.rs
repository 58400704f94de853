//! Scans in E57 through the program: written and read by another library.

use std::io::Cursor;

use e57::{
    CartesianBounds, CartesianCoordinate, E57Reader, E57Writer, Quaternion, Record, RecordDataType,
    RecordName, RecordValue, Transform, Translation,
};
use glam::{DQuat, DVec3};
use simod_tests::Workplace;

use crate::las::kill_after;

/// Points of a scan.
const COUNT: usize = 60_000;

/// Pose of the second scan; the first one has none.
fn pose() -> (DQuat, DVec3) {
    (DQuat::from_xyzw(0.0, 0.36, 0.48, 0.8), DVec3::new(412_345.5, 5_318_765.25, 100.0))
}

/// A point of a scan, in the frame that both share.
fn vertex(scan: usize, i: usize) -> DVec3 {
    let (u, v) = ((i / 300) as f64 / 150.0, (i % 300) as f64 / 150.0);
    let shift = if scan == 0 { 0.0 } else { 0.003 };
    let (_, far) = pose();
    far + DVec3::new(u + shift, v + shift, 0.2 * (5.0 * u).sin() * (4.0 * v).cos())
}

/// Two scans: integers in steps of 0.1 mm, and doubles with a pose.
fn write(work: &Workplace, name: &str) {
    let mut writer = E57Writer::from_file(work.path(name), "guid").expect("a file");
    writer.set_coordinate_metadata(Some("PROJCS[\"ETRS89 / UTM zone 32N\"]".to_owned()));
    let (rotation, far) = pose();
    for scan in 0..2 {
        let record = |name, data_type| Record { name, data_type };
        let coordinate = |name, offset| {
            let integers =
                RecordDataType::ScaledInteger { min: -300_000, max: 300_000, scale: 0.0001, offset };
            record(name, if scan == 0 { integers } else { RecordDataType::Double { min: None, max: None } })
        };
        let byte = || RecordDataType::Integer { min: 0, max: 255 };
        let prototype = vec![
            coordinate(RecordName::CartesianX, far.x),
            coordinate(RecordName::CartesianY, far.y),
            coordinate(RecordName::CartesianZ, far.z),
            record(RecordName::CartesianInvalidState, RecordDataType::Integer { min: 0, max: 2 }),
            record(RecordName::ColorRed, byte()),
            record(RecordName::ColorGreen, byte()),
            record(RecordName::ColorBlue, byte()),
            record(RecordName::RowIndex, RecordDataType::Integer { min: 0, max: 199 }),
        ];
        let mut cloud = writer.add_pointcloud(&format!("scan {scan}"), prototype).expect("a cloud");
        if scan == 1 {
            cloud.set_name(Some("Tower".to_owned()));
            cloud.set_transform(Some(Transform {
                rotation: Quaternion { w: rotation.w, x: rotation.x, y: rotation.y, z: rotation.z },
                translation: Translation { x: far.x, y: far.y, z: far.z },
            }));
        }
        for i in 0..COUNT {
            let common = vertex(scan, i);
            let numbers = if scan == 0 {
                ((common - far) / 0.0001).round().to_array().map(|n| RecordValue::ScaledInteger(n as i64))
            } else {
                (rotation.inverse() * (common - far)).to_array().map(RecordValue::Double)
            };
            let invalid = if i % 501 == 7 { 2 } else { 0 };
            let others =
                [invalid, i as i64 % 256, i as i64 / 100, 7, i as i64 % 200].map(RecordValue::Integer);
            cloud.add_point(numbers.into_iter().chain(others).collect()).expect("a point");
        }
        cloud.finalize().expect("a cloud");
    }
    writer.add_blob(&mut Cursor::new([0x55; 3000])).expect("a blob");
    writer.finalize().expect("a file");
}

/// Each scan's points in the common frame, those that have a position; the others' bits; and its bounds.
fn read(bytes: &[u8]) -> Vec<(Vec<DVec3>, Vec<Vec<RecordValue>>, CartesianBounds)> {
    let mut reader = E57Reader::new(Cursor::new(bytes)).expect("a file");
    let clouds = reader.pointclouds();
    let read = clouds.iter().map(|cloud| {
        let points = reader.pointcloud_simple(cloud).expect("points").map(|point| point.expect("a point"));
        let valid = points.filter_map(|point| match point.cartesian {
            CartesianCoordinate::Valid { x, y, z } => Some(DVec3::new(x, y, z)),
            _ => None,
        });
        let valid = valid.collect();
        let raw = reader.pointcloud_raw(cloud).expect("points").map(|point| {
            let point = point.expect("a point");
            let is_valid = point[3] == RecordValue::Integer(0);
            point[if is_valid { 3 } else { 0 }..].to_vec()
        });
        (valid, raw.collect(), cloud.cartesian_bounds.clone().expect("bounds"))
    });
    read.collect()
}

/// Bends what is beyond the middle, and leaves the rest.
fn bent(p: DVec3) -> DVec3 {
    let u = (p.x - pose().1.x - 0.5).max(0.0);
    p + DVec3::new(0.0, 0.2 * u, 0.1 * u * u)
}

#[test]
fn scans_are_bent_in_the_frame_that_they_share() {
    let work = Workplace::new();
    write(&work, "scans.e57");
    work.simod("sample scans.e57 -o scans.simod --samples 2000");
    work.simod("reconstruct scans.simod --deformed scans.simod/samples.ply -o same.e57");
    assert!(work.read("same.e57") == work.read("scans.e57"));

    // The same as PLY becomes the same.
    let before = read(&work.read("scans.e57"));
    let all: Vec<DVec3> = before.iter().flat_map(|(points, ..)| points.clone()).collect();
    let header = "property double x\nproperty double y\nproperty double z\nend_header\n";
    let lines: String = all.iter().map(|p| format!("{:?} {:?} {:?}\n", p.x, p.y, p.z)).collect();
    work.write("all.ply", format!("ply\nformat ascii 1.0\nelement vertex {}\n{header}{lines}", all.len()));
    work.simod("sample all.ply -o all.simod --samples 2000");
    for name in ["scans", "all"] {
        work.move_samples(&format!("{name}.simod"), bent);
        let extension = if name == "all" { "ply" } else { "e57" };
        work.simod(&format!("reconstruct {name}.simod --deformed deformed.ply -o {name}-bent.{extension}"));
    }
    let after = read(&work.read("scans-bent.e57"));
    let expected = work.ply("all-bent.ply").positions();
    let found = after.iter().flat_map(|(points, ..)| points);
    for (i, (found, expected)) in found.zip(&expected).enumerate() {
        // The first scan has steps, the second one doubles; positions of both files differ by their last
        // digits.
        let bound = if i < before[0].0.len() { 0.6e-4 } else { 1e-5 };
        assert!((*found - *expected).abs().max_element() < bound, "{i}: {found} for {expected}");
    }
    for ((_, old, was), (_, new, is)) in before.iter().zip(&after) {
        assert!(old == new);
        assert!((was.y_max, was.z_max) != (is.y_max, is.z_max));
    }
    let report = work.report("info scans-bent.e57");
    assert_eq!(report["format"], "E57 1.0, 2 scans");
    assert_eq!(report["crs"], "ETRS89 / UTM zone 32N");
    assert_eq!(report["vertices"].as_u64(), Some(2 * COUNT as u64));
    let details = report["details"].to_string();
    assert!(details.contains("scan 2 (Tower)") && details.contains("with scale 0.0001"), "{details}");
    assert!(report["other_properties"].to_string().contains("uchar red"));
}

#[test]
fn attributes_reach_the_samples_and_refinements_read_parts() {
    let work = Workplace::new();
    write(&work, "scans.e57");
    work.simod("sample scans.e57 -o scans.simod --samples 1000");
    let far = pose().1;
    let line =
        format!("refine scans.simod --sphere {},{},{},0.3 --error 1e-4", far.x + 0.5, far.y + 0.5, far.z);
    let report = work.report(&line);
    assert!(report["added"].as_u64().is_some_and(|added| added > 10), "{report}");
    work.simod("reconstruct scans.simod --deformed scans.simod/samples.ply -o same.e57");
    assert!(work.read("same.e57") == work.read("scans.e57"));
}

#[test]
fn killed_and_gone_on_with() {
    let work = Workplace::new();
    write(&work, "scans.e57");
    work.simod("sample scans.e57 -o scans.simod --samples 1000");
    work.move_samples("scans.simod", bent);
    let line = "reconstruct scans.simod --deformed deformed.ply -o out.e57 --part-size 100K";
    work.simod(line);
    let expected = work.read("out.e57");
    let mut gone_on = 0;
    for parts in [1, 2, 4] {
        std::fs::remove_file(work.path("out.e57")).expect("an output");
        kill_after(&work, line, ".simod-out.e57.journal", parts);
        let report = work.report(&format!("{line} --resume"));
        gone_on += u32::from(report["resumed_bytes"].as_u64().is_some_and(|bytes| bytes > 0));
        assert!(work.read("out.e57") == expected, "killed after {parts} parts");
    }
    assert!(gone_on > 0, "it was never killed in the midst of it");
}

/// Points of one scan, without a pose, that are stored as integers of so many bits.
fn write_one(work: &Workplace, name: &str, bits: u32, description: Option<&str>) {
    let mut writer = E57Writer::from_file(work.path(name), "guid").expect("a file");
    let integers =
        |offset| RecordDataType::ScaledInteger { min: 0, max: (1 << bits) - 10, scale: 0.001, offset };
    let record = |name, data_type| Record { name, data_type };
    let far = pose().1;
    let prototype = vec![
        record(RecordName::CartesianX, integers(far.x - 1.0)),
        record(RecordName::CartesianY, integers(far.y - 1.0)),
        record(RecordName::CartesianZ, integers(far.z - 1.0)),
        record(RecordName::Intensity, RecordDataType::Integer { min: 0, max: 255 }),
    ];
    let mut cloud = writer.add_pointcloud("one", prototype).expect("a cloud");
    cloud.set_description(description.map(str::to_owned));
    for i in 0..20_000 {
        let numbers = ((vertex(0, 3 * i) - far) / 0.001).round().to_array().map(|n| n as i64 + 1000);
        let numbers = numbers.map(RecordValue::ScaledInteger);
        let intensity = RecordValue::Integer(i as i64 % 256);
        cloud.add_point(numbers.into_iter().chain([intensity]).collect()).expect("a point");
    }
    cloud.finalize().expect("a cloud");
    writer.finalize().expect("a file");
}

/// The points of the only scan, by another library.
fn read_one(bytes: &[u8]) -> Vec<[f64; 4]> {
    let mut reader = E57Reader::new(Cursor::new(bytes)).expect("a file");
    let cloud = reader.pointclouds().remove(0);
    let points = reader.pointcloud_simple(&cloud).expect("points");
    let points = points.map(|point| {
        let point = point.expect("a point");
        let CartesianCoordinate::Valid { x, y, z } = point.cartesian else { panic!("no position") };
        [x, y, z, f64::from(point.intensity.expect("an intensity"))]
    });
    points.collect()
}

#[test]
fn integers_get_other_ranges_where_their_bits_allow() {
    let work = Workplace::new();
    write_one(&work, "one.e57", 14, None);
    work.simod("sample one.e57 -o one.simod --samples 1000");
    // Its extent is twice as large, and elsewhere: beyond the range that it has, but not wider.
    let far = pose().1;
    let wide = |p: DVec3| far + DVec3::new(2.0 * (p.x - far.x) + 100.0, p.y - far.y, p.z - far.z - 2.0);
    work.move_samples("one.simod", wide);
    let line = "reconstruct one.simod --deformed deformed.ply -o out.e57";
    assert!(work.refuses(line, &["has no room in its integers"]).hint().contains("--offset auto"));
    let outcome = work.simod(&format!("{line} --offset auto"));
    assert!(
        outcome.stderr.contains("ranges of integers become others: cartesianX of scan 1"),
        "{}",
        outcome.stderr
    );
    let (before, after) = (read_one(&work.read("one.e57")), read_one(&work.read("out.e57")));
    for (before, after) in before.iter().zip(&after) {
        let expected = wide(DVec3::new(before[0], before[1], before[2]));
        let found = DVec3::new(after[0], after[1], after[2]);
        assert!((found - expected).abs().max_element() < 0.6e-3, "{found} for {expected}");
        // A coordinate that does not move stays on its number; numbers that are no positions are as before.
        assert!((before[1] - after[1]).abs() < 1e-9 && before[3] == after[3]);
    }
    // A second time, from there, to the bit.
    work.simod("sample out.e57 -o out.simod --samples 1000");
    work.simod("reconstruct out.simod --deformed out.simod/samples.ply -o same.e57 --offset auto");
    assert!(work.read("same.e57") == work.read("out.e57"));

    // Wider than any range of so many bits.
    work.move_samples("one.simod", |p| far + 20.0 * (p - far));
    let line = line.replace("out.e57", "none.e57");
    let named = ["cartesianX of scan 1 goes from", "no range of 14 bits"];
    work.refuses(&format!("{line} --offset auto"), &named);

    // Rounding is a part of what is expected, and nothing below it can be asked for.
    work.move_samples("one.simod", |p| p + DVec3::new(0.0, 0.0, 0.01));
    let report = work.report("reconstruct one.simod --deformed deformed.ply -o near.e57");
    let rms = report["expected_error"]["rms"].as_f64().expect("a number");
    let diagonal = report["diagonal"].as_f64().expect("a number");
    let rounding = 0.001 * 0.5 / diagonal;
    assert!((0.99 * rounding..1.2 * rounding).contains(&rms), "{rms:e} for {rounding:e}");
    let line = "reconstruct one.simod --deformed deformed.ply -o none.e57 --tolerance";
    work.refuses(&format!("{line} {:e}", 0.5 * rounding), &["positions are integers"]);
}

#[test]
fn what_another_format_holds_all_of_needs_no_word() {
    let work = Workplace::new();
    write_one(&work, "one.e57", 14, None);
    let report = work.report("convert one.e57 out.ply");
    assert_eq!(report["lost"].as_array().map(Vec::len), Some(0), "{report}");
    let expected = read_one(&work.read("one.e57"));
    let found = work.ply("out.ply").positions();
    assert!(found.iter().zip(&expected).all(|(a, b)| a.to_array() == b[..3]));
    write_one(&work, "told.e57", 14, Some("of the tower"));
    work.refuses("convert told.e57 none.ply", &["what is told of scans: description"]);
}

/// As where one scan of two has colours, and says of some points that they came from nowhere.
#[test]
fn scans_of_different_fields_become_one_cloud() {
    let work = Workplace::new();
    let mut writer = E57Writer::from_file(work.path("m.e57"), "guid").expect("a file");
    let record = |name, data_type| Record { name, data_type };
    let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    for scan in 0..2 {
        let number = |max| RecordDataType::Integer { min: 0, max };
        let mut prototype = axes.clone().map(|name| record(name, RecordDataType::F64)).to_vec();
        if scan == 1 {
            prototype.push(record(RecordName::CartesianInvalidState, number(2)));
            let colors = [RecordName::ColorRed, RecordName::ColorGreen, RecordName::ColorBlue];
            prototype.extend(colors.map(|name| record(name, number(255))));
        }
        let mut cloud = writer.add_pointcloud(&format!("scan {scan}"), prototype).expect("a cloud");
        for i in 0..50 {
            let mut values = [i, scan, 0].map(|n| RecordValue::Double(n as f64)).to_vec();
            if scan == 1 {
                values.extend([i % 5 / 4 * 2, i, 2, 3].map(RecordValue::Integer));
            }
            cloud.add_point(values).expect("a point");
        }
        cloud.finalize().expect("a cloud");
    }
    writer.finalize().expect("a file");
    let report = work.report("convert m.e57 m.laz --step 1 --lossy");
    assert_eq!(report["vertices"], 90);
    work.simod("convert m.laz m.csv --lossy");
    let text = String::from_utf8(work.read("m.csv")).expect("text");
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let red = rows[0].iter().position(|name| *name == "red").expect("a colour");
    assert_eq!((rows[1][0], rows[1][red], rows[50][0], rows[50][red]), ("0", "0", "49", "0"));
    assert_eq!((rows[90][0], rows[90][red]), ("48", "12336"));
    assert_eq!(rows.len(), 91);
}

#[test]
fn what_does_not_fit_is_refused_and_leaves_nothing() {
    let work = Workplace::new();
    write(&work, "scans.e57");
    work.simod("sample scans.e57 -o scans.simod --samples 1000");
    work.move_samples("scans.simod", |p| p + DVec3::new(50.0, 0.0, 0.0));
    let line = "reconstruct scans.simod --deformed deformed.ply -o out.e57";
    let outcome = work.refuses(line, &["moves to cartesianX = ", "of scan 1, which has room for "]);
    assert!(outcome.hint().contains("as floats"));
    work.refuses(
        "reconstruct scans.simod --deformed scans.simod/samples.ply -o out.ply",
        &["which points are of which of 2 scans, and their names; 1 pose"],
    );
    work.simod("convert scans.e57 out.ply --lossy");
    let far = work.ply("out.ply").positions()[COUNT + 10].distance(vertex(1, 10));
    assert!(far < 1e-8, "{far:e}");
    let mut bytes = work.read("scans.e57");
    bytes[5000] ^= 4;
    work.write("spoilt.e57", &bytes);
    work.refuses("sample spoilt.e57 -o none.simod", &["the checksum of page 4, at byte 4096, is wrong"]);
    work.write("short.e57", &bytes[..bytes.len() - 1]);
    work.refuses("sample short.e57 -o none.simod", &["short.e57", "bytes, but the file has"]);
    assert!(!work.path("none.simod").exists() && !work.path("out.e57").exists());
}

/// Fractions, which scanners have, become numbers of 16 bits, as those of LAS are.
#[test]
fn intensities_that_are_fractions_are_spread_in_las() {
    for (least, most) in [(0.0, 1.0), (-40.0, 10.0)] {
        let work = Workplace::new();
        let mut writer = E57Writer::from_file(work.path("m.e57"), "guid").expect("a file");
        let record = |name, data_type| Record { name, data_type };
        let axes = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut prototype = axes.map(|name| record(name, RecordDataType::F64)).to_vec();
        let limits = RecordDataType::Single { min: Some(least), max: Some(most) };
        prototype.push(record(RecordName::Intensity, limits));
        let mut cloud = writer.add_pointcloud("one", prototype).expect("a cloud");
        let intensity = |i: i32| least + (most - least) * (0.1 + i as f32 / 100.0);
        for i in 0..50 {
            let place = [f64::from(i), 0.0, 1.0].map(RecordValue::Double);
            let values = place.into_iter().chain([RecordValue::Single(intensity(i))]);
            cloud.add_point(values.collect()).expect("a point");
        }
        cloud.finalize().expect("a cloud");
        writer.finalize().expect("a file");
        let lost =
            format!("intensity (float), of which {least} to {most} become whole numbers from 0 to 65535");
        work.refuses("convert m.e57 m.las", &[&lost]);
        work.simod("convert m.e57 m.las --lossy");
        work.simod("convert m.las m.csv --lossy");
        let text = String::from_utf8(work.read("m.csv")).expect("text");
        for (i, line) in (0..).zip(text.lines().skip(1)) {
            let found: f32 = line.split(',').nth(3).expect("a cell").parse().expect("a number");
            assert!((found - 65535.0 * (0.1 + i as f32 / 100.0)).abs() < 0.6, "{line}");
        }
        // Without a word on limits as well, where all are fractions.
        if most == 1.0 {
            work.simod("convert m.e57 m.ply --lossy");
            work.simod("convert m.ply again.las --lossy");
            work.simod("convert again.las again.csv --lossy");
            assert!(work.read("again.csv") == work.read("m.csv"));
        }
    }
}
