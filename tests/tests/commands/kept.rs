//! Geometry of the samples at rest, which the first reconstruction keeps beside them, and which changes no
//! byte of any other.

use glam::DVec3;
use simod_tests::{MANY, Workplace};

const REST: &str = "model.simod/rest.bin";

const RECONSTRUCT: &str = "reconstruct model.simod --deformed deformed.ply -o out.ply";

fn deformed(options: &str) -> Workplace {
    let work = Workplace::new();
    work.simod(&format!("generate -o model.ply --vertices {} {options}", MANY / 20));
    work.simod(&format!("sample model.ply -o model.simod --samples {}", MANY / 1000));
    work.move_samples("model.simod", |p| p + DVec3::new(0.1 * p.y * p.y, 0.3 * p.x, 1.0));
    work
}

/// Outputs of both methods.
fn methods(work: &Workplace) -> [Vec<u8>; 2] {
    ["blended-jets", "projected-barycentric"].map(|method| {
        work.simod(&format!("{RECONSTRUCT} --method {method}"));
        work.read("out.ply")
    })
}

#[test]
fn what_is_kept_gives_the_same_bytes() {
    for options in ["", "--no-normals", "--no-faces", "--encoding ascii --double", "--shape bumpy-sphere"] {
        let work = deformed(options);
        let expected = ["blended-jets", "projected-barycentric"].map(|method| {
            let _ = std::fs::remove_file(work.path(REST));
            work.simod(&format!("{RECONSTRUCT} --method {method}"));
            work.read("out.ply")
        });
        let kept = work.read(REST);
        assert!(methods(&work) == expected, "{options}");
        assert!(work.read(REST) == kept, "{options}: it was written again");
        // Made by another number of threads, for several versions, it is the same file.
        std::fs::remove_file(work.path(REST)).expect("a file");
        ["a.ply", "b.ply"].iter().for_each(|name| work.write(name, work.read("deformed.ply")));
        let several = "reconstruct model.simod --deformed a.ply b.ply -o out-{}.ply --threads 5";
        work.simod(several);
        assert!(work.read(REST) == kept && work.read("out-b.ply") == expected[0], "{options}");
        work.simod(several);
        assert!(work.read("out-a.ply") == expected[0], "{options}");
        // A folder with it is still one that sampling may replace; of other samples it is made anew.
        work.simod("sample model.ply -o model.simod --samples 300");
        assert!(!work.path(REST).exists());
        work.write(REST, &kept);
        work.move_samples("model.simod", |p| p + DVec3::X);
        work.simod(RECONSTRUCT);
        let (other, out) = (work.read(REST), work.read("out.ply"));
        assert!(other != kept);
        std::fs::remove_file(work.path(REST)).expect("a file");
        work.simod(RECONSTRUCT);
        assert!(work.read(REST) == other && work.read("out.ply") == out, "{options}");
    }
}

/// Where parts touch, faces tell who is a stranger: that is kept as well.
#[test]
fn what_faces_tell_is_kept() {
    let work = Workplace::new();
    // Two boards, one on the other.
    let side = 60;
    let board = |y: f64| (0..side * side).map(move |i| DVec3::new((i % side) as f64, y, (i / side) as f64));
    let positions: Vec<DVec3> = board(0.0).chain(board(0.01)).collect();
    let mut text = String::new();
    for p in &positions {
        text += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for at in 0..2 * side * side {
        if at % side + 1 < side && at / side % side + 1 < side {
            let at = at + 1;
            text +=
                &format!("f {at} {} {}\nf {} {} {}\n", at + 1, at + side, at + 1, at + side + 1, at + side);
        }
    }
    work.write("model.obj", text);
    work.simod("sample model.obj -o model.simod --samples 600");
    assert!(work.path("model.simod/sheets.bin").exists());
    work.move_samples("model.simod", |p| if p.y > 0.005 { p + DVec3::Y * p.x } else { p });
    let line = "reconstruct model.simod --deformed deformed.ply -o out.obj";
    work.simod(line);
    let (expected, kept) = (work.read("out.obj"), work.read(REST));
    work.simod(line);
    assert!(work.read("out.obj") == expected && work.read(REST) == kept);
}

#[test]
fn damaged_it_is_made_anew() {
    let work = deformed("");
    work.simod(RECONSTRUCT);
    let (expected, good) = (work.read("out.ply"), work.read(REST));
    let mut older = good.clone();
    older[8] = 0;
    let flipped = (0..12).map(|i| i * good.len() / 12).chain([good.len() - 1]).map(|at| {
        let mut bytes = good.clone();
        bytes[at] ^= 0x41;
        bytes
    });
    let cut = [0, 7, 20, good.len() / 2, good.len() - 1].map(|end| good[..end].to_vec());
    for bytes in flipped.chain(cut).chain([older, b"SIMODRST".to_vec()]) {
        work.write(REST, bytes);
        let outcome = work.simod(RECONSTRUCT);
        assert!(
            outcome.lines("note: ").is_empty() && outcome.lines("warning: ").is_empty(),
            "{}",
            outcome.stderr
        );
        assert!(work.read("out.ply") == expected && work.read(REST) == good);
    }
    // The kept file cannot be given as an output.
    work.refuses(&format!("{RECONSTRUCT} --force").replace("out.ply", REST), &["rest.bin"]);
    work.refuses(&format!("generate -o {REST} --vertices 2000 --force"), &["rest.bin"]);
}

#[cfg(unix)]
#[test]
fn what_cannot_be_kept_is_not() {
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 3000 --no-normals --no-faces");
    let model = work.read("model.ply").len() as u64;
    work.simod("sample model.ply -o model.simod --samples 1500");
    let line = "reconstruct model.simod --deformed model.simod/samples.ply -o out.ply";
    // Somebody is writing the folder.
    let lock = std::fs::File::create(work.path(".simod-model.simod.part")).expect("a file");
    lock.lock().expect("a lock");
    work.simod(line);
    assert!(!work.path(REST).exists());
    drop(lock);
    // In its place there is a link, a pipe or a folder.
    work.write("victim", "precious");
    std::os::unix::fs::symlink(work.path("victim"), work.path(REST)).expect("a link");
    work.simod(line);
    assert_eq!(work.read("victim"), b"precious");
    std::fs::remove_file(work.path(REST)).expect("a link");
    std::fs::create_dir(work.path(REST)).expect("a folder");
    work.simod(line);
    std::fs::remove_dir(work.path(REST)).expect("a folder");
    // There is room for the model, and no more.
    let expected = work.read("out.ply");
    let outcome = work.run_beyond(model.next_multiple_of(512) + 512, line);
    assert_eq!(outcome.code, Some(0), "{}", outcome.stderr);
    assert!(work.read("out.ply") == expected && !work.path(REST).exists());
    assert!(work.names().iter().all(|name| !name.starts_with(".simod")), "{:?}", work.names());
    work.simod(line);
    assert!(work.read(REST).len() as u64 > model, "no more room was needed");
}

#[test]
fn two_at_once_keep_it() {
    let work = deformed("");
    work.simod(RECONSTRUCT);
    let (expected, good) = (work.read("out.ply"), work.read(REST));
    for _ in 0..3 {
        std::fs::remove_file(work.path(REST)).expect("a file");
        let children = ["a.ply", "b.ply", "c.ply"].map(|name| {
            work.command(&RECONSTRUCT.replace("out.ply", name)).spawn().expect("the program starts")
        });
        for mut child in children {
            assert!(child.wait().expect("an end").success());
        }
        assert!(["a.ply", "b.ply", "c.ply"].iter().all(|name| work.read(name) == expected));
        assert!(work.read(REST) == good);
    }
}
