//! The cache beside a sampled model, made of models that cannot be read from anywhere.

use glam::DVec3;
use simod_tests::Workplace;

/// Rows and columns of the points.
const N: usize = 90;

fn vertex(k: usize) -> [f32; 3] {
    let (u, v) = ((k / N) as f32 / N as f32, (k % N) as f32 / N as f32);
    [u, v, 0.2 * (5.0 * u).sin() * (4.0 * v).cos()]
}

fn moved(p: DVec3) -> DVec3 {
    p + DVec3::new(0.1 * p.y * p.y, 0.3 * p.x, 1.0 + p.x * p.y)
}

const HEADER: &str = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 8100\nHEIGHT 1\n";

/// The points, shifted along x, as a file that is not compressed, and as one that is: by runs of 32 bytes.
fn pcd(shift: f32) -> [Vec<u8>; 2] {
    let points: Vec<[f32; 3]> = (0..N * N).map(|k| vertex(k).map(|x| x + shift)).collect();
    let records: Vec<u8> = points.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let fields: Vec<u8> = (0..3).flat_map(|c| points.iter().flat_map(move |p| p[c].to_le_bytes())).collect();
    let packed: Vec<u8> =
        fields.chunks(32).flat_map(|run| [vec![run.len() as u8 - 1], run.to_vec()].concat()).collect();
    let sizes = [packed.len() as u32, fields.len() as u32].map(u32::to_le_bytes).concat();
    [
        [format!("{HEADER}DATA binary\n").as_bytes(), &records].concat(),
        [format!("{HEADER}DATA binary_compressed\n").as_bytes(), &sizes, &packed].concat(),
    ]
}

/// Words of a note that a file is filled.
const SAYS: &str = "are unpacked into";

#[test]
fn a_compressed_file_is_unpacked_once_beside_the_samples() {
    let work = Workplace::new();
    let [plain, compressed] = pcd(0.0);
    work.write("plain.pcd", &plain);
    work.write("m.pcd", &compressed);
    work.simod("sample plain.pcd -o plain.simod --samples 500");
    let outcome = work.simod("sample m.pcd -o m.simod --samples 500 --json");
    let says: Vec<&str> = outcome.stderr.lines().filter(|line| line.contains(SAYS)).collect();
    assert!(
        says.len() == 1 && says[0].contains("m.simod/cache.bin, which takes 97.3 kB"),
        "{}",
        outcome.stderr
    );
    assert_eq!(outcome.json()["cache_bytes"].as_u64(), Some(plain.len() as u64));
    assert!(work.read("m.simod/samples.ply") == work.read("plain.simod/samples.ply"));
    let filled = work.read("m.simod/cache.bin");
    assert_eq!(filled[..plain.len()], plain);

    // All that read the model again use it, and none says that it is filled.
    work.move_samples("m.simod", moved);
    work.simod("reconstruct plain.simod --deformed deformed.ply -o expected.pcd");
    let expected = work.read("expected.pcd");
    let reconstruct = "reconstruct m.simod --deformed deformed.ply -o out.pcd";
    for line in
        [reconstruct, "bind m.simod", "refine m.simod --factor 2 --sphere 0.5,0.5,0,0.3 --into fine.simod"]
    {
        let outcome = work.simod(line);
        assert!(!outcome.stderr.contains(SAYS), "{line}: {}", outcome.stderr);
    }
    assert!(work.read("out.pcd") == expected);
    // The cache goes along with the samples.
    assert!(work.read("fine.simod/cache.bin") == filled);

    // Removed, damaged, of another version or cut off, it is made anew.
    for spoilt in [None, Some(filled[..1000].to_vec()), Some([&filled[..500], b"?", &filled[501..]].concat())]
    {
        match &spoilt {
            None => std::fs::remove_file(work.path("m.simod/cache.bin")).expect("a cache"),
            Some(bytes) => work.write("m.simod/cache.bin", bytes),
        }
        std::fs::remove_file(work.path("out.pcd")).expect("an output");
        let outcome = work.simod(reconstruct);
        assert!(outcome.stderr.contains(SAYS), "{}", outcome.stderr);
        assert!(work.read("out.pcd") == expected && work.read("m.simod/cache.bin") == filled);
    }
    assert!(work.names().iter().all(|name| !name.starts_with(".simod")), "{:?}", work.names());

    // A model that was moved is the same one; another one of the same size and time is not.
    std::fs::rename(work.path("m.pcd"), work.path("n.pcd")).expect("a file");
    let outcome = work.simod(&format!("{reconstruct} --model n.pcd"));
    assert!(!outcome.stderr.contains(SAYS), "{}", outcome.stderr);
    work.write("m.pcd", &pcd(0.25)[1]);
    let line = reconstruct.replace("out.pcd", "no.pcd");
    work.run(&line).refused(&line, &["m.pcd changed since it was sampled"]);
}

#[test]
fn a_folder_that_cannot_be_written_does_without() {
    let work = Workplace::new();
    work.write("m.pcd", &pcd(0.0)[1]);
    work.simod("sample m.pcd -o m.simod --samples 500");
    std::fs::remove_file(work.path("m.simod/cache.bin")).expect("a cache");
    // Somebody is writing the folder.
    let lock = std::fs::File::create(work.path(".simod-m.simod.part")).expect("a file");
    lock.lock().expect("a lock");
    let outcome = work.simod("reconstruct m.simod --deformed m.simod/samples.ply -o out.pcd");
    assert!(outcome.stderr.contains("into a temporary file in "), "{}", outcome.stderr);
    assert!(!work.path("m.simod/cache.bin").exists());
}

#[test]
fn commands_without_a_folder_leave_nothing() {
    let work = Workplace::new();
    let [plain, compressed] = pcd(0.0);
    work.write("m.pcd", &compressed);
    for line in ["info m.pcd", "convert m.pcd out.ply", "render m.pcd -o out.png"] {
        let outcome = work.simod(&format!("{line} --json"));
        assert!(outcome.stderr.contains("into a temporary file in "), "{line}: {}", outcome.stderr);
        assert_eq!(outcome.json()["cache_bytes"].as_u64(), Some(plain.len() as u64), "{line}");
    }
    work.write_session("m.pcd", 500, "[[step]]\ndeform = \"warp\"");
    // Converted, sampled, and reconstructed: unpacked once.
    let outcome = work.simod("run edit.toml");
    assert_eq!(outcome.stderr.matches(SAYS).count(), 1, "{}", outcome.stderr);
    assert_eq!(work.names(), ["edit.toml", "edited.ply", "m.pcd", "out.ply", "out.png"]);
}

/// Bytes of the file that is being made in a folder; none if there is none.
#[cfg(unix)]
fn in_the_making(folder: &std::path::Path) -> Option<u64> {
    let mut names = std::fs::read_dir(folder).ok()?.filter_map(Result::ok);
    let part = names.find(|name| name.file_name().to_string_lossy().starts_with(".simod"))?;
    Some(part.metadata().ok()?.len())
}

/// Killed while it is written, and at moments before and after that.
#[cfg(unix)]
#[test]
fn a_cache_is_whole_or_made_anew() {
    let work = Workplace::new();
    // The same points many times over, so that it takes long.
    let times = 80;
    let fields: Vec<u8> = (0..3)
        .flat_map(|c| (0..times).flat_map(move |_| (0..N * N).flat_map(move |k| vertex(k)[c].to_le_bytes())))
        .collect();
    let packed: Vec<u8> =
        fields.chunks(32).flat_map(|run| [vec![run.len() as u8 - 1], run.to_vec()].concat()).collect();
    let header = HEADER.replace("8100", &(times * N * N).to_string());
    let sizes = [packed.len() as u32, fields.len() as u32].map(u32::to_le_bytes).concat();
    work.write("m.pcd", [format!("{header}DATA binary_compressed\n").as_bytes(), &sizes, &packed].concat());
    work.simod("sample m.pcd -o m.simod --samples 500");
    let filled = work.read("m.simod/cache.bin");
    work.move_samples("m.simod", moved);
    let line = "reconstruct m.simod --deformed deformed.ply -o out.pcd --force";
    work.simod(line);
    let expected = work.read("out.pcd");

    let folder = work.path("m.simod");
    let (mut is_part, mut seed) = (0, 12_345u64);
    for round in 0..8 {
        std::fs::remove_file(folder.join("cache.bin")).expect("a cache");
        let mut command = work.command(line);
        command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
        let mut child = command.spawn().expect("a start");
        let is_running = |child: &mut std::process::Child| child.try_wait().expect("a child").is_none();
        // Half of them once some of it is there, the others whenever it is.
        let some = |bytes: u64| round % 2 == 0 || bytes > round * fields.len() as u64 / 15;
        while round > 0 && !in_the_making(&folder).is_some_and(some) && is_running(&mut child) {
            std::thread::sleep(std::time::Duration::from_micros(100));
        }
        if round % 2 == 0 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            std::thread::sleep(std::time::Duration::from_micros((seed >> 33) % 100_000));
        }
        child.kill().expect("a child");
        child.wait().expect("an end");
        is_part += u32::from(in_the_making(&folder).is_some_and(|bytes| bytes > 0));
        // A cache that is there is complete.
        if folder.join("cache.bin").exists() {
            assert!(work.read("m.simod/cache.bin") == filled, "round {round}");
        }
        work.simod(line);
        assert!(
            work.read("out.pcd") == expected && work.read("m.simod/cache.bin") == filled,
            "round {round}"
        );
        assert_eq!(in_the_making(&folder), None, "round {round}");
    }
    assert!(is_part > 0, "it was never killed in the midst of it");

    // A folder that is not there yet does not appear with a part of it.
    for wait in [5, 20, 40, 80] {
        let mut command = work.command("sample m.pcd -o n.simod --samples 500");
        command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
        let mut child = command.spawn().expect("a start");
        std::thread::sleep(std::time::Duration::from_millis(wait));
        child.kill().expect("a child");
        child.wait().expect("an end");
        if work.path("n.simod").exists() {
            assert!(work.read("n.simod/cache.bin") == filled, "after {wait} ms");
        }
    }
    work.simod("sample m.pcd -o n.simod --samples 500");
    assert!(work.read("n.simod/cache.bin") == filled);
    assert!(work.names().iter().all(|name| !name.starts_with(".simod")), "{:?}", work.names());
}

#[cfg(unix)]
#[test]
fn a_disk_without_room_is_told_and_nothing_is_left() {
    let work = Workplace::new();
    work.write("m.pcd", &pcd(0.0)[1]);
    let outcome = work.refuses_beyond(40 << 10, "sample m.pcd -o m.simod", &["cannot write", "m.simod"]);
    assert!(outcome.hint().contains("another disk"), "{}", outcome.hint());
}

/// Corners that share normals: who shares which is found out by the first reconstruction.
#[test]
fn shared_normals_are_looked_up_once() {
    let work = Workplace::new();
    let mut text: String =
        (0..N * N).map(vertex).map(|[x, y, z]| format!("v {x:.5} {y:.5} {z:.5}\n")).collect();
    text += "vn 0 0 1\nvn 0 0.6 0.8\n";
    for k in (0..N * (N - 1)).filter(|k| k % N < N - 1) {
        text += &format!("f {0}//{3} {1}//{3} {2}//{3}\n", k + 1, k + N + 1, k + 2, 1 + k % 2);
    }
    work.write("m.obj", &text);
    let outcome = work.simod("sample m.obj -o m.simod --samples 500");
    assert!(!outcome.stderr.contains("cache.bin"), "{}", outcome.stderr);
    work.move_samples("m.simod", |p| DVec3::new(p.x, -p.z, p.y));
    let says = |outcome: &simod_tests::Outcome| outcome.stderr.contains("which corners share which normal");
    let line = "reconstruct m.simod --deformed deformed.ply -o out.obj";
    assert!(says(&work.simod(line)));
    let (out, filled) = (work.read("out.obj"), work.read("m.simod/cache.bin"));
    assert!(!says(&work.simod(line)));
    std::fs::remove_file(work.path("m.simod/cache.bin")).expect("a cache");
    assert!(says(&work.simod(line)));
    assert!(work.read("out.obj") == out && work.read("m.simod/cache.bin") == filled);
    let text = String::from_utf8(out).expect("text");
    let normals: Vec<&str> = text.lines().filter(|line| line.starts_with("vn")).collect();
    assert_eq!(normals.len(), 2);
    assert!(normals[0].contains("-1") && normals[1].contains("-0.8"), "{normals:?}");
}
