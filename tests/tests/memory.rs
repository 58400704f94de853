//! Memory does not grow with the model.

use simod_tests::{OPTIMISED, Workplace, skip};

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
        // What is held is held: a peak of nothing would be a broken measurement.
        assert!(sixteen > 5 * MEGABYTE, "{phase} takes {sixteen} bytes");
    }
}
