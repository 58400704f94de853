//! `simod render --turntable`: a full turn of a model or of its samples, frame by frame.

use simod_tests::Workplace;
use std::fs::File;
use std::io::BufReader;

const FRAMES: [&str; 4] = ["frame-0001.png", "frame-0002.png", "frame-0003.png", "frame-0004.png"];

fn names(work: &Workplace, folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(work.path(folder)).expect("the folder");
    let name = |e: std::io::Result<std::fs::DirEntry>| e.expect("an entry").file_name();
    let mut names: Vec<String> = entries.map(|e| name(e).to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn pixels(work: &Workplace, name: &str) -> Vec<u8> {
    let decoder = png::Decoder::new(BufReader::new(File::open(work.path(name)).expect("a picture")));
    let mut reader = decoder.read_info().expect("a PNG file");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    reader.next_frame(&mut pixels).expect("pixels");
    pixels
}

/// Mean difference of two pictures, of 255.
fn differ(work: &Workplace, a: &str, b: &str) -> f64 {
    let (a, b) = (pixels(work, a), pixels(work, b));
    assert_eq!(a.len(), b.len());
    let sum: u64 = a.iter().zip(&b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.len() as f64
}

#[test]
fn a_full_turn_of_what_looks_the_same_from_all_sides() {
    let work = Workplace::new();
    work.simod("generate --shape cylinder -o model.ply --vertices 20000");
    work.simod("sample model.ply -o model.simod --samples 4000");
    let before = work.names();
    for (of, most) in [("model.ply", 1.0), ("model.simod", 1.5)] {
        // The box around a cylinder is widest across a corner, so that the camera stands as far back as for
        // all.
        let how = "--size 160x160 --yaw 45";
        work.simod(&format!("render {of} -o plain.png {how}"));
        let report = work.report(&format!("render {of} -o turn --turntable 4 {how}"));
        assert_eq!(report["frames"], 4);
        assert_eq!(names(&work, "turn"), FRAMES);
        assert!(work.read("plain.png") == work.read("turn/frame-0001.png"), "{of}: the first is the picture");
        for frame in &FRAMES[1..] {
            let off = differ(&work, "plain.png", &format!("turn/{frame}"));
            assert!(off < most, "{of}, {frame}: {off} of 255");
        }
    }
    assert_eq!(work.names().len(), before.len() + 2);
}

/// A long thing is neither cut at its widest, nor does it grow and shrink: its picture is as high in all
/// frames.
#[test]
fn the_camera_stays_as_far_away() {
    let work = Workplace::new();
    work.simod("generate --shape bar -o model.ply --vertices 20000");
    work.simod("render model.ply -o turn --turntable 3 --size 120x120 --up x --pitch 0");
    let heights = FRAMES[..3].iter().map(|frame| {
        let pixels = pixels(&work, &format!("turn/{frame}"));
        let rows: Vec<&[u8]> = pixels.chunks_exact(3 * 120).collect();
        // The model is not as grey as what is behind it.
        let clay = |row: &&&[u8]| row.chunks_exact(3).any(|p| p[0] > p[2].saturating_add(12));
        let (first, last) = (rows.iter().position(|r| clay(&r)), rows.iter().rposition(|r| clay(&r)));
        assert!(first > Some(0) && last < Some(119), "{frame} is cut: {first:?}, {last:?}");
        last.unwrap_or(0) - first.unwrap_or(0)
    });
    let heights: Vec<usize> = heights.collect();
    assert!(heights.iter().all(|h| *h > 5 && h.abs_diff(heights[0]) <= 8), "{heights:?}");
}

#[test]
fn what_is_there_stays_where_it_is_no_turntable() {
    let work = Workplace::new();
    work.simod("generate --shape bar -o model.ply --vertices 2000");
    let render = "render model.ply --size 64x64 -o turn --turntable";
    work.simod(&format!("{render} 3"));
    work.simod(&format!("{render} 2"));
    assert_eq!(names(&work, "turn"), FRAMES[..2]);
    work.write("turn/thesis.tex", "");
    work.refuses(&format!("{render} 2"), &["turn", "thesis.tex"]);
    assert_eq!(names(&work, "turn").len(), 3);
    work.refuses("render model.ply -o model.ply --turntable 2", &["model.ply"]);
    for frames in ["0", "10000", "many"] {
        assert_eq!(work.run(&format!("{render} {frames}")).code, Some(2), "{frames}");
    }
    // A full disk, in the middle of it.
    #[cfg(unix)]
    {
        let before = work.names();
        work.refuses_beyond(2000, "render model.ply --size 64x64 -o new --turntable 3", &["new"]);
        assert_eq!(work.names(), before);
    }
}
