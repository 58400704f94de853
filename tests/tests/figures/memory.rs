//! Memory does not grow with the model.

use simod_tests::{OPTIMISED, Workplace, skip};

/// Anonymous memory at its peak while a shuffled model, of 384 MB of samples, is sampled below a limit.
#[test]
#[cfg(target_os = "linux")]
fn a_limit_holds_for_a_shuffled_model() {
    if !OPTIMISED {
        return skip("16 million vertices take minutes in a build without optimisation");
    }
    const LIMIT: u64 = 160 * 1024 * 1024;
    let work = Workplace::new();
    work.simod("generate -o model.ply --vertices 16000000 --no-faces --no-colors");
    let bytes = work.read("model.ply");
    let header = bytes.len() - 16_000_000 * 24;
    let (head, body) = bytes.split_at(header);
    // 7 919 477 is odd and no multiple of 5: it visits all vertices once.
    let mut shuffled = Vec::with_capacity(bytes.len());
    shuffled.extend_from_slice(head);
    for i in 0..body.len() / 24 {
        let from = i * 7_919_477 % (body.len() / 24) * 24;
        shuffled.extend_from_slice(&body[from..from + 24]);
    }
    work.write("model.ply", shuffled);
    let report =
        work.report(&format!("sample model.ply -o model.simod --samples 100000 --memory-limit {LIMIT}"));
    let peak = report["peak_memory_bytes"].as_u64().expect("a peak");
    assert!(peak < LIMIT, "{} MB", peak / MEGABYTE);
    // Half of the limit is used before anything waits in a file.
    assert!(peak > LIMIT / 4, "{} MB", peak / MEGABYTE);
}

/// Peaks of anonymous memory while a point cloud is sampled, and while it is reconstructed.
struct Peaks {
    sample: u64,
    reconstruct: u64,
}

const MEGABYTE: u64 = 1_000_000;

fn peaks(vertices: u64) -> Peaks {
    let work = Workplace::new();
    // Normals matter for what is kept of each vertex; faces and colours would fill the disk alone.
    work.simod(&format!("generate -o model.ply --vertices {vertices} --no-faces --no-colors"));
    let peak = |line: &str| {
        let report = work.report(line);
        assert_eq!(report["vertices"], vertices);
        report["peak_memory_bytes"].as_u64()
    };
    let sample = peak("sample model.ply -o model.simod --samples 100000");
    // Everything moves: where nothing does, the work is shorter.
    work.move_samples("model.simod", |p| 2.0 * p);
    let reconstruct = peak("reconstruct model.simod --deformed deformed.ply -o out.ply");
    Peaks { sample: sample.expect("a peak"), reconstruct: reconstruct.expect("a peak") }
}

/// With as many samples, a coarse grid of the same resolution, and 8 times the vertices.
#[test]
#[cfg(target_os = "linux")]
fn of_sampling_does_not_depend_on_the_number_of_vertices() {
    if !OPTIMISED {
        return skip("32 million vertices take minutes in a build without optimisation");
    }
    let peak = |vertices: u64| {
        let work = Workplace::new();
        let line = format!("generate -o model.ply --vertices {vertices} --no-faces --no-colors --no-normals");
        work.simod(&line);
        // The least of three: threads take turns as they come, and leave more or less to the allocator.
        let once = || {
            let report =
                work.report("sample model.ply -o model.simod --samples 200000 --grid 64 --threads 2");
            report["peak_memory_bytes"].as_u64().expect("a peak")
        };
        (0..3).map(|_| once()).min().expect("three runs")
    };
    let (four, thirty_two) = (peak(4_000_000), peak(32_000_000));
    // About 60 MB; what the allocator keeps in reserve varies.
    for peak in [four, thirty_two] {
        assert!(peak < 80 * MEGABYTE, "{} MB", peak / MEGABYTE);
    }
    assert!(thirty_two < four + 12 * MEGABYTE, "{} MB, {} MB", four / MEGABYTE, thirty_two / MEGABYTE);
}

#[test]
#[cfg(target_os = "linux")]
fn of_16_million_vertices_is_below_200_megabytes() {
    if !OPTIMISED {
        return skip("16 million vertices take minutes in a build without optimisation");
    }
    let (two, sixteen) = (peaks(2_000_000), peaks(16_000_000));
    let phases =
        [("sampling", two.sample, sixteen.sample), ("reconstruction", two.reconstruct, sixteen.reconstruct)];
    for (phase, two, sixteen) in phases {
        assert!(sixteen < 200 * MEGABYTE, "{phase} takes {} MB", sixteen / MEGABYTE);
        assert!(
            sixteen < two + 40 * MEGABYTE,
            "{phase} takes {} MB for 2 million vertices, {} MB for 16",
            two / MEGABYTE,
            sixteen / MEGABYTE
        );
        // Some memory is always held: a peak of nothing would be a broken measurement.
        assert!(sixteen > 5 * MEGABYTE, "{phase} takes {sixteen} bytes");
    }
}
