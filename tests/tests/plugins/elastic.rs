//! A soft body, from a session to the model's vertices.

use glam::DVec3;
use simod_tests::Workplace;

const STEP: &str = "[[step]]
deform = \"elastic\"
params = { resolution = 16, poisson = 0.49, weight = WEIGHT }
[[step.region]]
role = \"fixed\"
shapes = [{ half-space = { point = [0, 0.3, 0], normal = [0, -1, 0] } }]
";

/// A bar that stands on its end, and is drawn aside by its weight.
#[test]
fn a_heavy_bar_bends_to_where_its_weight_draws() {
    let work = Workplace::new();
    work.simod("generate --shape bar -o bar.ply --vertices 20000");
    let before = work.ply("bar.ply").positions();
    let run = |weight: &str| {
        work.write_session("bar.ply", 4000, &STEP.replace("WEIGHT", weight));
        work.simod("run edit.toml -o out.ply --force");
        work.ply("out.ply").positions()
    };
    assert!(run("0.0").iter().zip(&before).all(|(q, p)| q == p), "what is not heavy stays");
    let out = run("0.005, down = [1, 0, 0]");
    let tip = |places: &[DVec3]| {
        let top = before.iter().zip(places).filter(|(p, _)| p.y > 1.95);
        top.clone().map(|(_, q)| *q).sum::<DVec3>() / top.count() as f64
    };
    let way = tip(&out) - tip(&before);
    assert!(way.x > 0.2 && way.y < 0.0 && way.z.abs() < 0.01, "{way}");
    let still = before.iter().zip(&out).filter(|(p, _)| p.y < 0.2);
    assert!(still.clone().count() > 500 && still.clone().all(|(p, q)| p.distance(*q) < 1e-6));
    // Nothing holds it.
    let step = STEP.replace("WEIGHT", "0.005").split("[[step.region]]").next().unwrap_or_default().to_owned();
    work.write_session("bar.ply", 4000, &step);
    work.refuses("run edit.toml --force", &["nothing holds the body"]);
}
