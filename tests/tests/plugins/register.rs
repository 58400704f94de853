//! A model that is deformed to another one, from a session to its vertices, and what is told where that
//! cannot be.

use glam::DVec3;
use simod_tests::{Ply, Workplace};

const STEP: &str = "[[step]]\ndeform = \"register\"\n";

/// The cactus, and what a bend has made of it, whose vertices are the same in the same order.
fn cacti() -> Workplace {
    let work = Workplace::new();
    work.simod("generate --shape cactus -o cactus.ply --vertices 30000");
    let bend =
        "[[step]]\ndeform = \"warp\"\nparams = { operation = \"bend\", axis = [0, 1, 0], angle = 35 }\n";
    work.write_session("cactus.ply", 3000, bend);
    work.simod("run edit.toml -o target.ply");
    work
}

/// Registers the cactus to a file, with parameters.
fn register(work: &Workplace, target: &str, params: &str) {
    work.write_session("cactus.ply", 3000, &format!("{STEP}params = {{ target = \"{target}\"{params} }}\n"));
}

/// The root of the mean square of the distances between vertices, of those that belong to `counts` in `b`, as
/// a part of the diagonal.
fn apart(a: &Ply, b: &Ply, counts: impl Fn(&DVec3) -> bool) -> f64 {
    let pairs = a.positions().into_iter().zip(b.positions()).filter(|(_, q)| counts(q));
    let squares: Vec<f64> = pairs.map(|(p, q)| p.distance_squared(q)).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt() / a.diagonal()
}

#[test]
fn a_bent_model_is_met_though_a_third_is_missing() {
    let work = cacti();
    let (rest, target) = (work.ply("cactus.ply"), work.ply("target.ply"));
    let before = apart(&rest, &target, |_| true);
    register(&work, "target.ply", "");
    let told = work.report("run edit.toml -o out.ply --measure");
    let error = apart(&work.ply("out.ply"), &target, |_| true);
    assert!(before > 0.02 && error < 0.15 * before, "{error}, before {before}");
    assert!(told["notes"].to_string().contains("of the target match"), "{told}");
    // The same with a cloud that has no upper third, in another order.
    let [low, high] = target.bounds();
    let kept = |p: &DVec3| p.y < low.y + 0.67 * (high.y - low.y);
    let mut cloud: Vec<DVec3> = target.positions().into_iter().filter(kept).collect();
    cloud.reverse();
    let text: String = cloud.iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
    work.write("part.xyz", text);
    register(&work, "part.xyz", "");
    work.simod("run edit.toml -o out.ply --force");
    let error = apart(&work.ply("out.ply"), &target, kept);
    assert!(error < 0.3 * before, "{error}, before {before}");
}

#[test]
fn other_units_places_and_files_are_told() {
    let work = cacti();
    let moved = |name: &str, by: &dyn Fn(DVec3) -> DVec3| {
        let places: Vec<DVec3> = work.ply("target.ply").positions().into_iter().map(by).collect();
        let text: String = places.iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
        work.write(name, text);
    };
    moved("millimetres.xyz", &|p| 1000.0 * p);
    register(&work, "millimetres.xyz", "");
    let refused = work.refuses("run edit.toml -o out.ply", &["units may differ"]);
    assert!(refused.hint().contains("similarity"), "{}", refused.stderr);
    register(&work, "millimetres.xyz", ", align = \"similarity\", place = \"model\"");
    work.simod("run edit.toml -o out.ply");
    let size = work.ply("out.ply").diagonal() / work.ply("target.ply").diagonal();
    assert!((0.9..1.1).contains(&size), "{size}");
    moved("beside.xyz", &|p| p + DVec3::new(50.0, 0.0, 0.0));
    register(&work, "beside.xyz", ", align = \"none\"");
    let refused = work.refuses("run edit.toml --force", &["they do not overlap"]);
    assert!(refused.hint().contains("align = \"rigid\""), "{}", refused.stderr);
    register(&work, "beside.xyz", ", method = \"align\"");
    assert!(work.simod("run edit.toml -o out.ply --force").stderr.contains("beside it"));
    work.write("few.xyz", "0 0 0\n1 0 0\n");
    register(&work, "few.xyz", "");
    work.refuses("run edit.toml --force", &["less than four"]);
    register(&work, "nowhere.ply", "");
    work.refuses("run edit.toml --force", &["nowhere.ply"]);
}
